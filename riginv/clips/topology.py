"""Comparison of a clip's topology with the rig's: number of vertices, and faces along the rig's edges."""

import numpy as np

from riginv.clips.sequence import MeshSequence
from riginv.errors import InputError, listed
from riginv.meshes.polygons import Polygons
from riginv.rig.interface import RigBackend

ORDER_FRAMES = 20  # at most, to find one with enough points
MIN_EDGES = 20  # with two known ends
LONGER = 3.0  # factor of the edges' length in a clip beyond what any pose does to them


class TopologyError(InputError):
    """A clip is not the rig's mesh.

    Attributes:
        same_count: whether it has as many vertices as the rig.
    """

    def __init__(self, message: str, same_count: bool) -> None:
        super().__init__(message)
        self.same_count = same_count


def check_topology(clip: MeshSequence, rig: RigBackend, faces: bool = True) -> str:
    """Compare a clip's mesh with the rig's.

    Every edge of the clip must be an edge of the rig, or the other diagonal of two of its triangles: the rig's faces are
    triangles, the clip's need not be. Clips with another vertex order fail this check.

    Args:
        faces: whether to compare faces.

    Returns:
        a note for the user, or an empty text.

    Raises:
        TopologyError: the vertices or the faces differ; the message names both counts.
    """
    rig_vertices, rig_faces = len(rig.rest_vertices), rig.faces.cpu().numpy()
    counts = f"{clip.vertex_count} vertices" + (f" and {len(clip.faces)} faces" if clip.faces else "")
    if clip.vertex_count != rig_vertices:
        raise TopologyError(
            f"{clip.path}: {counts}, rig '{rig.name}' has {rig_vertices} vertices and {len(rig_faces)} faces: a clip must "
            f"hold the rig's own mesh, its vertices in the same order{_meshes(clip)}; riginv.invert rig=NAME "
            f"correspondence=surface fits any mesh, reading.vertices=FILE names the rig's vertices in a larger mesh",
            same_count=False,
        )
    if not faces or not len(rig_faces):
        return ""
    if not clip.faces:
        _check_order(clip, rig)
        return "the clip has no faces, so the order of its vertices cannot be checked: it is assumed to be the rig's"
    wrong = foreign_edges(clip.faces, rig_faces, rig_vertices)
    if len(wrong):
        first, second = wrong[0].tolist()
        raise TopologyError(
            f"{clip.path}: {counts}, rig '{rig.name}' has {len(rig_faces)} faces, and {len(wrong)} edges of the clip are none "
            f"of the rig's, the first from vertex {first} to {second}: the vertices are in another order, or it is another "
            f"mesh; reading.check_faces=false accepts it",
            same_count=True,
        )
    return ""


def _check_order(clip: MeshSequence, rig: RigBackend) -> None:
    """Compare the edges of the rig on the points of a clip without faces with those on the rig, relative to the mesh's size.

    Raises:
        TopologyError: they are so much longer that the points cannot be in the rig's order.
    """
    edges = Polygons.triangles(rig.faces.cpu().numpy()).edges()
    for index in range(min(len(clip), ORDER_FRAMES)):
        with np.errstate(invalid="ignore"):  # damaged files hold NaN of every kind
            points = clip.read(index, index + 1)[0].astype(np.float64)
        known = np.isfinite(points[edges]).all(axis=(1, 2))
        if known.sum() >= MIN_EDGES:
            break
    else:
        return
    longer = _relative_length(points, edges[known]) / _relative_length(rig.rest_vertices.double().cpu().numpy(), edges[known])
    if longer > LONGER:
        raise TopologyError(
            f"{clip.path}: {clip.vertex_count} points without faces, as many as rig '{rig.name}' has vertices, but in another "
            f"order: its edges would be {longer:.3g} times as long as on the rig: correspondence=surface fits a point cloud",
            same_count=False,
        )


def _relative_length(points: np.ndarray, edges: np.ndarray) -> float:
    """Median length of edges, relative to the median distance of their ends from the centre."""
    ends = points[edges]
    away = np.linalg.norm(ends[:, 0] - np.median(ends[:, 0], axis=0), axis=1)
    return float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)) / max(float(np.median(away)), 1e-30))


def _meshes(clip: MeshSequence) -> str:
    """The meshes read and those left out, where there was a choice."""
    if not clip.facts.other_meshes:
        return ""
    read, others = (listed(names) for names in (clip.facts.meshes, clip.facts.other_meshes))
    return f"; read were {read}, and not {others} (reading.mesh=[NAME] chooses)"


def foreign_edges(polygons: Polygons, rig_faces: np.ndarray, vertices: int) -> np.ndarray:
    """Edges `(edge, 2)` of polygons that are neither edges of the rig nor the other diagonal of two of its triangles."""
    known = Polygons.triangles(rig_faces).edges()
    edges = polygons.edges()
    foreign = edges[~np.isin(_key(edges, vertices), _key(known, vertices))]
    return foreign[~np.isin(_key(foreign, vertices), _key(_other_diagonals(rig_faces), vertices))] if len(foreign) else foreign


def _other_diagonals(faces: np.ndarray) -> np.ndarray:
    """For every edge shared by two triangles, the edge `(edge, 2)` between their opposite corners."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    far = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, far = edges[order], far[order]
    same = (edges[1:] == edges[:-1]).all(axis=1)
    return np.sort(np.stack([far[1:][same], far[:-1][same]], axis=1), axis=1)


def _key(edges: np.ndarray, vertices: int) -> np.ndarray:
    return edges[:, 0] * vertices + edges[:, 1]
