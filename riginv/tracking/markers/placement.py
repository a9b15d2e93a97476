"""Positions of markers on a rig's surface: points of its triangles, with an offset along the normal."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from riginv.rig.interface import RigBackend


@dataclass(frozen=True)
class Placement:
    """The places of markers on a rig's surface.

    Attributes:
        names: of the markers.
        corners: vertex indices of the triangle of each marker, `(marker, 3)`.
        barycentric: weights of the corners, `(marker, 3)`, that sum to 1.
        offset_mm: along the triangle's normal, outwards, `(marker,)`.
        calibrated: whether the offset is to be estimated from the clip, `(marker,)`; `offset_mm` is then the start.
    """

    names: tuple[str, ...]
    corners: Tensor
    barycentric: Tensor
    offset_mm: Tensor
    calibrated: Tensor

    def __len__(self) -> int:
        return len(self.names)

    def subset(self, markers: Sequence[int]) -> "Placement":
        """Some of the markers, by their indices."""
        some = list(markers)
        tensors = (self.corners, self.barycentric, self.offset_mm, self.calibrated)
        return Placement(tuple(self.names[index] for index in some), *(values[some] for values in tensors))

    def with_offsets(self, offset_mm: Tensor) -> "Placement":
        """The same markers at other offsets `(marker,)`."""
        return replace(self, offset_mm=offset_mm)

    def points(self, vertices: Tensor) -> Tensor:
        """The markers `(..., marker, 3)` on meshes `(..., vertex, 3)`, mm."""
        return points_on(vertices[..., self.corners, :], self.barycentric, self.offset_mm)


def at_vertices(rig: RigBackend, names: Sequence[str], vertices: Sequence[int], offset_mm: float | None = None) -> Placement:
    """Markers at vertices of a rig; an offset of None is to be calibrated."""
    pairs = [_triangle_at(rig, vertex) for vertex in vertices]
    corners = torch.stack([triangle for triangle, _ in pairs])
    barycentric = torch.eye(3)[[corner for _, corner in pairs]]
    offsets = torch.full((len(names),), offset_mm or 0.0)
    return Placement(tuple(names), corners, barycentric, offsets, torch.full((len(names),), offset_mm is None))


def _triangle_at(rig: RigBackend, vertex: int) -> tuple[Tensor, int]:
    """The largest triangle at a vertex, and which of its corners the vertex is; three times the vertex where it has none."""
    rows = (rig.faces == vertex).any(dim=1).nonzero()[:, 0]
    if not len(rows):
        return torch.tensor([vertex] * 3), 0
    triangles = rig.faces[rows].cpu().long()
    first, second, third = rig.rest_vertices.cpu()[triangles].unbind(dim=1)
    best = triangles[torch.linalg.cross(second - first, third - first).norm(dim=1).argmax()]
    return best, int((best == vertex).nonzero()[0, 0])


def points_on(corners: Tensor, barycentric: Tensor, offset_mm: Tensor) -> Tensor:
    """Points `(..., marker, 3)` on triangles `(..., marker, corner, 3)`, mm, with offsets `(marker,)` along their normals."""
    points = (barycentric[..., None] * corners).sum(dim=-2)
    return points + offset_mm[:, None] * normals(corners)[0] if bool(offset_mm.any()) else points


def normals(corners: Tensor) -> tuple[Tensor, Tensor]:
    """Unit normals `(..., marker, 3)` of triangles `(..., marker, corner, 3)`, and twice their areas `(..., marker)`."""
    first, second, third = corners.unbind(dim=-2)
    normal = torch.linalg.cross(second - first, third - first)
    size = normal.norm(dim=-1).clamp_min(1e-12)
    return normal / size[..., None], size


def point_derivatives(corners: Tensor, barycentric: Tensor, offset_mm: Tensor) -> Tensor:
    """Derivatives of `points_on` by the corners: `(..., marker, 3, corner, 3)`."""
    eye = torch.eye(3).to(corners)
    result = barycentric[..., None, :, None] * eye[:, None]
    result = result.expand(*corners.shape[:-2], 3, 3, 3)
    if not bool(offset_mm.any()):
        return result
    normal, size = normals(corners)
    first, second, third = corners.unbind(dim=-2)
    across = (eye - normal[..., :, None] * normal[..., None, :]) * (offset_mm / size)[..., None, None]
    by_second, by_third = -across @ _cross_matrix(third - first), across @ _cross_matrix(second - first)
    return result + torch.stack([-by_second - by_third, by_second, by_third], dim=-2)


def _cross_matrix(vectors: Tensor) -> Tensor:
    """Matrices `(..., 3, 3)` whose product with a vector is the cross product of `vectors` `(..., 3)` with it."""
    x, y, z = vectors.unbind(dim=-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
