"""Loop subdivision as a sparse matrix, which refines many shapes by one product, also on a part of the mesh.

`trimesh.remesh.subdivide_loop` gives the same positions inside a mesh (a test compares the two); on borders it also uses
neighbours that are not along the border, which tears ragged edges.
"""

import numpy as np
from scipy import sparse


def loop_matrix(triangles: np.ndarray, edges: np.ndarray, edge_of_side: np.ndarray) -> sparse.csr_array:
    """One step of Loop subdivision (Loop 1987, with its boundary rules).

    Args:
        triangles: `(triangle, 3)` indices of points.
        edges: `(edge, 2)`, as from `unique_edges`.
        edge_of_side: `(triangle, 3)` the edges on the sides 01, 12 and 20.

    Returns:
        `(point + edge, point)`: the old points smoothed, then one new point on each edge.
    """
    points, count = int(triangles.max()) + 1, len(edges)
    opposite = _incidence(edge_of_side.ravel(), np.roll(triangles, 1, axis=1).ravel(), count, points)
    ends = _incidence(np.repeat(np.arange(count), 2), edges.ravel(), count, points)
    interior = np.bincount(edge_of_side.ravel(), minlength=count) == 2
    new = sparse.diags_array(np.where(interior, 3 / 8, 1 / 2)) @ ends + sparse.diags_array(interior / 8) @ opposite

    neighbours = _adjacency(edges, points)
    valence = neighbours.sum(axis=1)
    beta = (40 - (2 * np.cos(2 * np.pi / valence) + 3) ** 2) / (64 * valence)
    border = np.isin(np.arange(points), edges[~interior])
    old = sparse.diags_array(np.where(border, 3 / 4, 1 - valence * beta))
    old += sparse.diags_array(np.where(border, 0, beta)) @ neighbours
    old += sparse.diags_array(border / 8) @ _adjacency(edges[~interior], points)
    return sparse.vstack([old, new], format="csr")


def unique_edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges `(edge, 2)` of triangles, and for each triangle the edges on its sides 01, 12 and 20, `(triangle, 3)`."""
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, edge_of_side = np.unique(sides, axis=0, return_inverse=True)
    return edges, edge_of_side.reshape(-1, 3)


def split_triangles(triangles: np.ndarray, edge_points: np.ndarray) -> np.ndarray:
    """Split triangles `(triangle, 3)` at the points on their sides 01, 12 and 20, where there is one (-1: none)."""
    faces = []
    for (a, b, c), (ab, bc, ca) in zip(triangles.tolist(), edge_points.tolist()):
        # Rotate the corners until the split sides come first.
        while (ab < 0) + (bc < 0) + (ca < 0) in (1, 2) and (ab < 0 or (ca >= 0 and bc < 0)):
            (a, b, c), (ab, bc, ca) = (b, c, a), (bc, ca, ab)
        if ab < 0:
            faces += [(a, b, c)]
        elif bc < 0:
            faces += [(a, ab, c), (ab, b, c)]
        elif ca < 0:
            faces += [(ab, b, bc), (a, ab, bc), (a, bc, c)]
        else:
            faces += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.array(faces)


def border_smoothing(triangles: np.ndarray, movable: np.ndarray, rounds: int = 12) -> sparse.csr_array:
    """Smooth a mesh's border along itself, `(point, point)`; only the points that are `movable` `(point,)` move."""
    points = len(movable)
    edges, edge_of_side = unique_edges(triangles)
    along = _adjacency(edges[np.bincount(edge_of_side.ravel()) == 1], points)
    moves = movable & (along.sum(axis=1) == 2)
    step = sparse.diags_array(np.where(moves, 1 / 2, 1)) + sparse.diags_array(moves / 4) @ along
    result = sparse.eye_array(points, format="csr")
    for _ in range(rounds):
        result = step @ result
    return result


def _adjacency(edges: np.ndarray, points: int) -> sparse.csr_array:
    return _incidence(edges.ravel(), edges[:, ::-1].ravel(), points, points)


def _incidence(rows: np.ndarray, columns: np.ndarray, row_count: int, column_count: int) -> sparse.csr_array:
    return sparse.coo_array((np.ones(len(rows)), (rows, columns)), shape=(row_count, column_count)).tocsr()
