"""An avatar's geometry: vertices, triangles and morph targets of all its chosen meshes, in the world, in millimetres."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from riginv.errors import InputError
from rigs.gltf.accessors import MOST_NUMBERS
from rigs.gltf.container import GltfFile, open_gltf
from rigs.gltf.pieces import Piece, pieces
from rigs.gltf.scene import Scene, read_scene
from rigs.gltf.selection import rig_meshes
from rigs.gltf.skins import Carriers
from rigs.gltf.targets import default_weights
from rigs.gltf.weld import weld_map

FARTHEST_MM = 1e8  # from the origin that a vertex may lie, 100 km: beyond it a file is damaged


@dataclass(frozen=True)
class Avatar:
    """What a file holds of a rig.

    Attributes:
        file, scene: what was read.
        pieces: where vertices come from, in the order of the file's vertices.
        targets: the names of the morph targets of all meshes, each once.
        defaults: the weights of the targets at rest, by name: as the file gives them where that was asked for, else 0.
        vertex_map: the rig's vertex of each of the file's, `(file vertex,)`.
        rest: `(vertex, 3)` float64, mm, with every target at 0.
        deltas: `(target, vertex, 3)` float32, mm.
        faces: `(face, 3)`.
        mm: millimetres to a unit of the file.
    """

    file: GltfFile
    scene: Scene
    pieces: list[Piece]
    targets: list[str]
    defaults: dict[str, float]
    vertex_map: np.ndarray
    rest: np.ndarray
    deltas: np.ndarray
    faces: np.ndarray
    mm: float


def read_avatar(
    path: str | Path,
    include: list[str],
    exclude: list[str],
    mm: float = 1000.0,
    weld: bool = False,
    joints: bool = False,
    at_defaults: bool = False,
) -> Avatar:
    """Read an avatar.

    Args:
        include, exclude: globs of the names of meshes or their nodes.
        mm: millimetres to a unit of the file, which glTF says is a metre.
        weld: make one of the vertices that seams split.
        joints: whether meshes that only a skin moves belong to it.
        at_defaults: whether the targets rest at the weights that the file gives them.

    Raises:
        InputError: the file cannot be read, holds nothing that moves, or is damaged.
    """
    file = open_gltf(path)
    scene = read_scene(file)
    parts = pieces(file, rig_meshes(file, scene, include, exclude, joints))
    targets = list(dict.fromkeys(name for piece in parts for name in piece.targets))
    number_of = {name: number for number, name in enumerate(targets)}
    count = sum(piece.count for piece in parts)
    if 3 * count * (1 + len(targets)) > MOST_NUMBERS:
        raise InputError(
            f"{file.path}: {count} vertices with {len(targets)} morph targets need {12e-9 * count * len(targets):.1f} GB: "
            f"choose meshes with rig.include=[NAME]"
        )
    vertex_map = weld_map(file, scene, parts) if weld else np.arange(count)
    vertices = int(vertex_map.max()) + 1
    rest, deltas = np.zeros((vertices, 3)), np.zeros((len(targets), vertices, 3), np.float32)
    faces = []
    for piece in parts:
        carriers, here = piece.carriers(file, scene), vertex_map[piece.vertices]
        blend = blended(carriers, slice(None), mm)
        rest[here] = turned(blend, piece.positions(file)) + blend[:, :, 3]
        for name, change in piece.deltas(file):
            deltas[number_of[name], here] = turned(blend, change)
        triangles = here[piece.triangles(file)]
        faces.append(triangles[:, ::-1] if np.linalg.det(carriers.transforms[0, :, :3]) < 0 else triangles)
    check_distances(file, rest, deltas)
    faces = np.concatenate(faces)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]  # welding may have closed one
    defaults = _defaults(file, parts) if at_defaults else dict.fromkeys(targets, 0.0)
    return Avatar(file, scene, parts, targets, defaults, vertex_map, rest, deltas, faces, mm)


def check_distances(file: GltfFile, *arrays: np.ndarray) -> None:
    """Raises InputError where numbers in mm are beyond what an avatar can have."""
    for array in arrays:
        if not np.abs(array).max(initial=0.0) < FARTHEST_MM:
            raise InputError(
                f"{file.path}: its nodes place vertices farther than {FARTHEST_MM / 1e6:g} km away: check the scales of its "
                f"nodes, and rig.unit_mm"
            )


def blended(carriers: Carriers, some: slice | np.ndarray, mm: float) -> np.ndarray:
    """What places each vertex in the world: `(vertex, 3, 4)`, mm, the sum over `some` carriers in the shares of each."""
    shares, transforms = carriers.shares[:, some], carriers.transforms[some] * mm
    return (shares @ transforms.reshape(-1, 12)).reshape(-1, 3, 4)


def turned(blend: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors `(vertex, 3)` of the file's own coordinates in the world, `(vertex, 3)`, mm; nothing is added to them."""
    return (blend[:, :, :3] @ vectors[:, :, None])[:, :, 0]


def _defaults(file: GltfFile, parts: list[Piece]) -> dict[str, float]:
    """The weights at rest of all targets; those that meshes share must agree."""
    found: dict[str, tuple[float, str]] = {}
    for piece in parts:
        node = file.document["nodes"][piece.node]
        for name, weight in default_weights(file, piece.mesh, node, list(piece.targets)).items():
            before, label = found.setdefault(name, (weight, piece.label))
            if before != weight:
                raise InputError(
                    f"{file.path}: target '{name}' rests at {before} in {label}, at {weight} in {piece.label}, which one "
                    f"control cannot: leave a mesh out with rig.exclude=[NAME], or rest all at 0 by rig.default_weights=false"
                )
    return {name: weight for name, (weight, _) in found.items()}
