"""Selection of the meshes of a clip: as the user names, else those with the rig's topology."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import Polygons
from riginv.clips.topology import foreign_edges
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from rigs.gltf.container import GltfFile
from rigs.gltf.rig import GltfRig
from rigs.gltf.scene import Scene
from rigs.gltf.selection import MeshName, mesh_name, mesh_nodes, named_meshes, with_targets, with_targets_or_skin
from rigs.gltf.submeshes import read_submeshes

BY_NAME = "those of the rig"
MOST_COMPARED = 12  # selections with the rig's number of vertices whose faces are compared


class ClipMeshes(NamedTuple):
    """A selection of meshes for a clip.

    Attributes:
        nodes: nodes of the meshes, in the order of the vertices.
        welded: index of the rig's vertex for each of the file's, `(file vertex,)`, where the rig is welded; else None.
        reason: of the selection, for the user; empty where it was requested.
        fits: whether they were compared with the rig and have its vertices and faces.
    """

    nodes: list[int]
    welded: np.ndarray | None = None
    reason: str = ""
    fits: bool = True


def clip_meshes(file: GltfFile, scene: Scene, options: ReadingOptions, rig: RigBackend | None) -> list[ClipMeshes]:
    """Selections of meshes that fit a rig, the best first; where none fits, the one that a rig of the file would have.

    Args:
        rig: rig of the clip, where known.

    Raises:
        InputError: the file has no meshes, or not the requested ones.
    """
    trial = replace(file, notes=[])  # notes about meshes that are not selected are dropped
    if options.mesh_names:
        nodes = _in_order_of_rig(trial, scene, named_meshes(file, scene, options.mesh_names, "reading.mesh"), rig)
        fitting = _fitting(trial, nodes, options, rig) if rig else None
        return [ClipMeshes(nodes, fitting.welded if fitting else None)]
    if not mesh_nodes(trial, scene):
        raise InputError(f"{file.path}: no mesh in its scene: export it with its meshes, or give another clip")
    candidates = list(_candidates(trial, scene, rig))
    selection: list[ClipMeshes] = []
    if rig and options.vertices is None:
        counts, rest = _vertex_counts(trial, scene), {len(rig.rest_vertices)}
        rest |= {len(rig.vertex_map)} if isinstance(rig, GltfRig) else set()
        for nodes, reason in candidates:
            if sum(counts[node] for node in nodes) in rest and len(selection) < MOST_COMPARED:
                fitting = _fitting(trial, nodes, options, rig)
                selection += [fitting._replace(reason=reason)] if fitting else []
                if fitting and reason == BY_NAME:
                    break
    return selection or [ClipMeshes(candidates[0][0], None, candidates[0][1], fits=False)]


def _candidates(file: GltfFile, scene: Scene, rig: RigBackend | None) -> Iterator[tuple[list[int], str]]:
    """Distinct selections and the reason for each."""
    nodes, seen = mesh_nodes(file, scene), set[tuple[int, ...]]()
    several = (
        (_of_names(file, scene, rig.meshes) if isinstance(rig, GltfRig) else [], BY_NAME),
        (with_targets(file, nodes), "those with morph targets"),
        (with_targets_or_skin(file, nodes), "those with morph targets or a skin"),
        (nodes, "all that there are"),
        *(([node], "whose vertices and faces are the rig's") for node in nodes),
    )
    for selected, reason in several:
        if selected and tuple(selected) not in seen:
            seen.add(tuple(selected))
            yield selected, reason


def _of_names(file: GltfFile, scene: Scene, names: tuple[MeshName, ...]) -> list[int]:
    """Nodes of the meshes of a rig, in the rig's order; empty where one is missing."""
    nodes = mesh_nodes(file, scene)
    by_node = {scene.names[node]: node for node in nodes}
    by_mesh = {mesh_name(file, scene, node).mesh: node for node in reversed(nodes)}
    found = [by_node.get(name.node, by_mesh.get(name.mesh or name.node, -1)) for name in names]
    return found if -1 not in found and len(set(found)) == len(found) else []


def _in_order_of_rig(file: GltfFile, scene: Scene, nodes: list[int], rig: RigBackend | None) -> list[int]:
    """The nodes, in the rig's order where they are its meshes."""
    ours = _of_names(file, scene, rig.meshes) if isinstance(rig, GltfRig) else []
    return ours if sorted(ours) == sorted(nodes) else nodes


def _vertex_counts(file: GltfFile, scene: Scene) -> dict[int, int]:
    """Number of vertices of the mesh of each node; 0 for damaged meshes."""
    of_mesh: dict[int, int] = {}
    nodes = mesh_nodes(file, scene)
    for node in nodes:
        mesh = file.document["nodes"][node]["mesh"]
        if mesh not in of_mesh:
            try:
                of_mesh[mesh] = sum(submesh.count for submesh in read_submeshes(file, [node]))
            except InputError:
                of_mesh[mesh] = 0
    return {node: of_mesh[file.document["nodes"][node]["mesh"]] for node in nodes}


def _fitting(file: GltfFile, nodes: list[int], options: ReadingOptions, rig: RigBackend) -> ClipMeshes | None:
    """The meshes of nodes as a clip of a rig; None where they do not fit."""
    try:
        parts = read_submeshes(file, nodes)
        faces = np.concatenate([submesh.start + submesh.triangles(file) for submesh in parts])
    except InputError:  # damaged or without triangles; reported where it is read
        return None
    count, welded = sum(submesh.count for submesh in parts), None
    if isinstance(rig, GltfRig) and options.vertices is None and len(rig.rest_vertices) < count == len(rig.vertex_map):
        welded = rig.vertex_map.cpu().numpy()
        faces, count = welded_faces(faces, welded), len(rig.rest_vertices)
    if count != len(rig.rest_vertices):
        return None
    ours = rig.faces.cpu().numpy()
    if options.check_faces and len(ours) and len(foreign_edges(Polygons.triangles(faces), ours, count)):
        return None
    return ClipMeshes(nodes, welded)


def welded_faces(faces: np.ndarray, welded: np.ndarray) -> np.ndarray:
    """Triangles `(face, 3)` of welded vertices, without degenerate ones."""
    faces = welded[faces]
    return faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
