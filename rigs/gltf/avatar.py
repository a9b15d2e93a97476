"""Geometry of an avatar: vertices, triangles and morph targets of its chosen meshes in world space, mm."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from riginv.errors import InputError
from rigs.gltf.accessors import MOST_NUMBERS
from rigs.gltf.container import GltfFile, open_gltf
from rigs.gltf.scene import Scene, read_scene
from rigs.gltf.selection import rig_meshes
from rigs.gltf.skins import PosedBinding
from rigs.gltf.submeshes import Submesh, read_submeshes, weld_map
from rigs.gltf.targets import default_weights

FARTHEST_MM = 1e8  # greatest distance of a vertex from the origin, 100 km: beyond it a file is damaged


@dataclass(frozen=True)
class Avatar:
    """Geometry read from a file.

    Attributes:
        file, scene: the file and its scene graph.
        submeshes: in the order of the file's vertices.
        targets: unique names of the morph targets of all meshes.
        defaults: rest weight of each target by name: the file's where requested, else 0.
        vertex_map: index of the rig's vertex for each of the file's, `(file vertex,)`.
        rest: `(vertex, 3)` float64, mm, with all targets at 0.
        deltas: `(target, vertex, 3)` float32, mm.
        faces: `(face, 3)`.
        mm: millimetres to a unit of the file.
    """

    file: GltfFile
    scene: Scene
    submeshes: list[Submesh]
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
        include, exclude: globs for the names of meshes or their nodes.
        mm: millimetres per unit of the file; glTF's unit is the metre.
        weld: merge vertices that seams have split.
        joints: include meshes that are only skinned.
        at_defaults: use the file's weights of the targets as their rest values.

    Raises:
        InputError: the file cannot be read, is damaged, or has no deformable mesh.
    """
    file = open_gltf(path)
    scene = read_scene(file)
    parts = read_submeshes(file, rig_meshes(file, scene, include, exclude, joints))
    targets = list(dict.fromkeys(name for submesh in parts for name in submesh.targets))
    number_of = {name: number for number, name in enumerate(targets)}
    count = sum(submesh.count for submesh in parts)
    if 3 * count * (1 + len(targets)) > MOST_NUMBERS:
        raise InputError(
            f"{file.path}: {count} vertices with {len(targets)} morph targets need {12e-9 * count * len(targets):.1f} GB: "
            f"choose meshes with rig.include=[NAME]"
        )
    vertex_map = weld_map(file, scene, parts) if weld else np.arange(count)
    vertices = int(vertex_map.max()) + 1
    rest, deltas = np.zeros((vertices, 3)), np.zeros((len(targets), vertices, 3), np.float32)
    all_faces = []
    for submesh in parts:
        binding, here = submesh.rest_binding(file, scene), vertex_map[submesh.vertices]
        blend = blend_transforms(binding, slice(None), mm)
        rest[here] = transform_vectors(blend, submesh.positions(file)) + blend[:, :, 3]
        for name, change in submesh.deltas(file):
            deltas[number_of[name], here] = transform_vectors(blend, change)
        triangles = here[submesh.triangles(file)]
        all_faces.append(triangles[:, ::-1] if np.linalg.det(binding.transforms[0, :, :3]) < 0 else triangles)
    check_distances(file, rest, deltas)
    faces = np.concatenate(all_faces)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]  # welding may have made some degenerate
    defaults = _defaults(file, parts) if at_defaults else dict.fromkeys(targets, 0.0)
    return Avatar(file, scene, parts, targets, defaults, vertex_map, rest, deltas, faces, mm)


def check_distances(file: GltfFile, *arrays: np.ndarray) -> None:
    """Raises InputError where coordinates, mm, are implausibly large."""
    for array in arrays:
        if not np.abs(array).max(initial=0.0) < FARTHEST_MM:
            raise InputError(
                f"{file.path}: its nodes place vertices farther than {FARTHEST_MM / 1e6:g} km away: check the scales of its "
                f"nodes, and rig.unit_mm"
            )


def blend_transforms(binding: PosedBinding, some: slice | np.ndarray, mm: float) -> np.ndarray:
    """Blended skinning matrices `(vertex, 3, 4)`, mm: the weighted sum over some nodes of a binding."""
    weights, transforms = binding.weights[:, some], binding.transforms[some] * mm
    return (weights @ transforms.reshape(-1, 12)).reshape(-1, 3, 4)


def transform_vectors(blend: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Apply the linear part of blended matrices to vectors `(vertex, 3)` of the file's coordinates."""
    return (blend[:, :, :3] @ vectors[:, :, None])[:, :, 0]


def _defaults(file: GltfFile, parts: list[Submesh]) -> dict[str, float]:
    """Rest weights of all targets; meshes with a target in common must agree."""
    found: dict[str, tuple[float, str]] = {}
    for submesh in parts:
        node = file.document["nodes"][submesh.node]
        for name, weight in default_weights(file, submesh.mesh, node, list(submesh.targets)).items():
            before, label = found.setdefault(name, (weight, submesh.label))
            if before != weight:
                raise InputError(
                    f"{file.path}: target '{name}' rests at {before} in {label}, at {weight} in {submesh.label}, which one "
                    f"control cannot: leave a mesh out with rig.exclude=[NAME], or rest all at 0 by rig.default_weights=false"
                )
    return {name: weight for name, (weight, _) in found.items()}
