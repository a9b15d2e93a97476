"""Which meshes of a file make a clip of a rig: those that the user names, else those that are the rig's mesh."""

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
from rigs.gltf.pieces import pieces
from rigs.gltf.rig import GltfRig
from rigs.gltf.scene import Scene
from rigs.gltf.selection import MeshName, mesh_name, mesh_nodes, named_meshes, with_targets, with_targets_or_skin

BY_NAME = "those of the rig"
MOST_COMPARED = 12  # selections of the rig's number of vertices whose faces are compared with the rig's


class ClipMeshes(NamedTuple):
    """Meshes that may make a clip.

    Attributes:
        nodes: whose meshes they are, in the order of the vertices.
        welded: the rig's vertex of each of the file's, `(file vertex,)`, where the rig welds them; else None.
        why: these were taken, for the user; empty where they were asked for.
    """

    nodes: list[int]
    welded: np.ndarray | None = None
    why: str = ""


def clip_meshes(file: GltfFile, scene: Scene, options: ReadingOptions, rig: RigBackend | None) -> list[ClipMeshes]:
    """The selections of meshes that are a rig's mesh, the best first; where none is, the one that a rig would take.

    Args:
        rig: that the clip is for; None: no rig is known.

    Raises:
        InputError: the file has no meshes, or not those that were asked for.
    """
    trial = replace(file, notes=[])  # what is found out about meshes that are not taken is no news
    if options.mesh_names:
        nodes = _in_order_of_rig(trial, scene, named_meshes(file, scene, options.mesh_names, "reading.mesh"), rig)
        taken = _fitting(trial, nodes, options, rig) if rig else None
        return [ClipMeshes(nodes, taken.welded if taken else None)]
    if not mesh_nodes(trial, scene):
        raise InputError(f"{file.path}: no mesh in its scene: export it with its meshes, or give another clip")
    given = list(_candidates(trial, scene, rig))
    found: list[ClipMeshes] = []
    if rig and options.vertices is None:
        counts, rest = _vertex_counts(trial, scene), {len(rig.rest_vertices)}
        rest |= {len(rig.vertex_map)} if isinstance(rig, GltfRig) else set()
        for nodes, why in given:
            if sum(counts[node] for node in nodes) in rest and len(found) < MOST_COMPARED:
                fitting = _fitting(trial, nodes, options, rig)
                found += [fitting._replace(why=why)] if fitting else []
                if fitting and why == BY_NAME:  # another mesh of the same faces is another mesh
                    break
    return found or [ClipMeshes(given[0][0], None, given[0][1])]


def _candidates(file: GltfFile, scene: Scene, rig: RigBackend | None) -> Iterator[tuple[list[int], str]]:
    """Selections, each once, and why they would be taken."""
    nodes, seen = mesh_nodes(file, scene), set()
    several = (
        (_of_names(file, scene, rig.meshes) if isinstance(rig, GltfRig) else [], BY_NAME),
        (with_targets(file, nodes), "those with morph targets"),
        (with_targets_or_skin(file, nodes), "those with morph targets or a skin"),
        (nodes, "all that there are"),
        *(([node], "whose vertices and faces are the rig's") for node in nodes),
    )
    for taken, why in several:
        if taken and tuple(taken) not in seen:
            seen.add(tuple(taken))
            yield taken, why


def _of_names(file: GltfFile, scene: Scene, names: tuple[MeshName, ...]) -> list[int]:
    """The nodes with the meshes of a rig, in the rig's order; empty where one of them is missing."""
    nodes = mesh_nodes(file, scene)
    by_node = {scene.names[node]: node for node in nodes}
    by_mesh = {mesh_name(file, scene, node).mesh: node for node in reversed(nodes)}
    found = [by_node.get(name.node, by_mesh.get(name.mesh or name.node, -1)) for name in names]
    return found if -1 not in found and len(set(found)) == len(found) else []


def _in_order_of_rig(file: GltfFile, scene: Scene, nodes: list[int], rig: RigBackend | None) -> list[int]:
    """The same nodes, in the rig's order where they are its meshes."""
    ours = _of_names(file, scene, rig.meshes) if isinstance(rig, GltfRig) else []
    return ours if sorted(ours) == sorted(nodes) else nodes


def _vertex_counts(file: GltfFile, scene: Scene) -> dict[int, int]:
    """How many vertices the mesh of each node has; damaged meshes none, which no rig has."""
    of_mesh: dict[int, int] = {}
    nodes = mesh_nodes(file, scene)
    for node in nodes:
        mesh = file.document["nodes"][node]["mesh"]
        if mesh not in of_mesh:
            try:
                of_mesh[mesh] = sum(piece.count for piece in pieces(file, [node]))
            except InputError:
                of_mesh[mesh] = 0
    return {node: of_mesh[file.document["nodes"][node]["mesh"]] for node in nodes}


def _fitting(file: GltfFile, nodes: list[int], options: ReadingOptions, rig: RigBackend) -> ClipMeshes | None:
    """The meshes of nodes as a clip of a rig; None where they are not its mesh."""
    try:
        parts = pieces(file, nodes)
        faces = np.concatenate([piece.start + piece.triangles(file) for piece in parts])
    except InputError:  # damaged, or no triangles: said where it is asked for
        return None
    count, welded = sum(piece.count for piece in parts), None
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
    """Triangles `(face, 3)` of welded vertices, without those that welding closed."""
    faces = welded[faces]
    return faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
