"""Mesh space: a few coordinates in which a mesh loss equals the loss on all vertices up to a constant.

A rig that ends in a linear map, x = rest + B (f(r) - f(neutral)), reaches only the span of its basis B. With B = Q R, Q
orthonormal, and the mesh coordinates z = Q^T (x - rest) of a mesh x,

    |x - rig(r)|^2  =  |z - R (f(r) - f(neutral))|^2  +  |the part of x outside the span|^2,

and the last term does not depend on r. For a black box, Q comes from samples instead, truncated at a given residual.
"""

import weakref

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.geometry.axis_basis import AxisBasisCache, axis_by_axis
from riginv.geometry.products import linear, matmul
from riginv.rig.interface import LinearRig, Vjp

SEARCH_VERTICES = 3000  # vertices used in the search for the number of components
RANK_TOLERANCE = 1e-6  # of the largest singular value; directions below it are noise of a float32 basis


class MeshSpace(nn.Module):
    """An orthonormal basis of displacements from a rest mesh.

    Attributes:
        rest_vertices: `(vertex, 3)`, mm.
        directions: Q, `(coordinate, vertex, 3)`; orthonormal, in order of decreasing singular value.
        residual_mm: mean vertex distance between the meshes it was fitted to and their projections; 0 where it is exact.
    """

    rest_vertices: Tensor
    directions: Tensor

    def __init__(
        self,
        rest_vertices: Float[Tensor, "vertex 3"],
        directions: Float[Tensor, "coordinate vertex 3"],
        residual_mm: float = 0.0,
    ) -> None:
        super().__init__()
        self.register_buffer("rest_vertices", rest_vertices, persistent=False)
        self.register_buffer("directions", directions, persistent=False)
        self.residual_mm = residual_mm
        self._by_axis = AxisBasisCache()
        self._mapped: tuple[Tensor, Tensor, Tensor] | None = None  # basis and directions, and the linear map between them
        self._of_basis: weakref.ref[Tensor] | None = None  # the basis that it is the span of

    @classmethod
    def from_rig(cls, rig: LinearRig) -> "MeshSpace":
        """The exact mesh space of a rig that ends in a linear map: the span of its basis.

        It takes seconds, and a command needs it in several places: one that is still in use is returned again.
        """
        for space in _EXACT:
            if space._of_basis is not None and space._of_basis() is rig.basis and space.rest_vertices is rig.rest_vertices:
                return space
        axes = axis_by_axis(rig.basis)
        if axes is None:
            directions, values = _orthonormal(rig.basis.flatten(1))
            directions = directions.unflatten(1, rig.rest_vertices.shape)
        else:
            directions, values = _orthonormal_by_axis(rig.basis, axes)
        kept = values > RANK_TOLERANCE * values.amax()
        found = cls(rig.rest_vertices, directions[kept].to(rig.dtype))
        found._of_basis = weakref.ref(rig.basis)
        _EXACT.add(found)
        return found

    @classmethod
    def from_samples(cls, rest_vertices: Tensor, samples: Tensor, residual_mm: float) -> "MeshSpace":
        """The fewest principal components of sampled meshes that come within `residual_mm` of them on average.

        Args:
            rest_vertices: `(vertex, 3)`, mm.
            samples: `(sample, vertex, 3)`, mm.
            residual_mm: the mean vertex distance, over all samples, that may remain.

        Raises:
            InputError: there are no samples, they hold NaN or infinite values, or the residual is not positive.
        """
        if not len(samples) or not torch.isfinite(samples).all():
            raise InputError("a mesh space needs at least one sampled mesh, and no NaN or infinite values in any")
        if not residual_mm > 0:
            raise InputError(f"residual_mm is {residual_mm}, expected a distance above 0")
        flat = (samples - rest_vertices).flatten(1).double()
        right = _principal_directions(flat, residual_mm)
        rank, coordinates = len(right), flat @ right.T
        some = slice(None, None, max(1, len(rest_vertices) // SEARCH_VERTICES))

        def residual(count: int, vertices: slice) -> float:
            of, by = (rows.unflatten(1, rest_vertices.shape)[:, vertices].flatten(1) for rows in (flat, right[:count]))
            rest = of - coordinates[:, :count] @ by
            return float(rest.unflatten(1, (-1, 3)).norm(dim=2).mean())

        low, high = 0, rank  # the residual falls as components are added: bisect for the fewest that suffice
        while low < high:
            middle = (low + high) // 2
            low, high = (low, middle) if residual(middle, some) <= residual_mm else (middle + 1, high)
        count = max(low, 1)
        remaining = residual(count, slice(None))
        while remaining > residual_mm and count < rank:  # all vertices may need more components than those of the search
            count = min(rank, count + max(1, count // 100))
            remaining = residual(count, slice(None))
        directions = right[:count].unflatten(1, rest_vertices.shape).to(rest_vertices.dtype)
        return cls(rest_vertices, directions, remaining)

    @property
    def size(self) -> int:
        """The number of mesh coordinates."""
        return len(self.directions)

    @property
    def vertex_count(self) -> int:
        return len(self.rest_vertices)

    def linear_map(self, basis: Float[Tensor, "coefficient vertex 3"]) -> Float[Tensor, "coefficient coordinate"]:
        """The mesh coordinates of each row of a basis; that of the last basis is kept, for the rigs that share it."""
        found = self._mapped  # read once: other threads may replace it
        if found is None or found[0] is not basis or found[1] is not self.directions:
            found = self._mapped = basis, self.directions, inner_products(basis, self.directions)
        return found[2]

    def encode(self, vertices: Float[Tensor, "batch vertex 3"]) -> Float[Tensor, "batch coordinate"]:
        """Meshes `(batch, vertex, 3)`, mm, to mesh coordinates `(batch, coordinate)`, by orthogonal projection."""
        displacements = vertices - self.rest_vertices
        if (by_axis := self._by_axis.get(self.directions, displacements)) is not None:
            return by_axis.products(displacements)
        return displacements.flatten(1) @ self.directions.flatten(1).T

    def decode(self, coordinates: Float[Tensor, "batch coordinate"]) -> Float[Tensor, "batch vertex 3"]:
        """Mesh coordinates `(batch, coordinate)` to meshes `(batch, vertex, 3)`, mm."""
        if (by_axis := self._by_axis.get(self.directions, coordinates)) is not None:
            return self.rest_vertices + by_axis.displacements(coordinates)
        return self.rest_vertices + (coordinates @ self.directions.flatten(1)).unflatten(1, self.rest_vertices.shape)


_EXACT: "weakref.WeakSet[MeshSpace]" = weakref.WeakSet()  # those of rigs, as long as they are used


def _principal_directions(flat: Tensor, residual_mm: float) -> Tensor:
    """Orthonormal directions `(direction, value)` of samples `(sample, value)`, in order of importance.

    Computed from the samples' Gram matrix, far faster than a decomposition of long samples. No more than leave a root mean
    square distance of `residual_mm` are needed, for the mean distance is no larger.
    """
    squares, vectors = torch.linalg.eigh(flat @ flat.T)
    squares = squares.clamp_min(0).flip(0)
    values = squares.sqrt()
    rank = max(int((values > RANK_TOLERANCE * values[0].clamp_min(1e-12)).sum()), 1)
    remaining = (squares.sum() - squares.cumsum(0)) / (len(flat) * flat.shape[1] / 3)
    enough = int((remaining > residual_mm**2).sum()) + 1
    rank = min(rank, enough)
    directions = vectors.flip(1)[:, :rank].T @ flat
    return torch.linalg.qr(directions.T)[0].T  # orthonormal to rounding: the Gram matrix squares the condition number


class RigInMeshSpace(nn.Module):
    """A rig composed with its mesh space: `forward` maps controls to mesh coordinates, without computing vertices.

    Attributes:
        source: the rig, which ends in a linear map.
        space: its mesh space.
        linear_map: R^T `(coefficient, coordinate)`: mesh coordinates per unit of each coefficient.
        neutral_coefficients: `(1, coefficient)`.
    """

    linear_map: Tensor
    neutral_coefficients: Tensor

    def __init__(self, rig: LinearRig, space: MeshSpace) -> None:
        super().__init__()
        self.source, self.space = rig, space
        self.register_buffer("linear_map", space.linear_map(rig.basis), persistent=False)
        self.register_buffer("neutral_coefficients", rig.neutral_coefficients().detach(), persistent=False)

    def leading(self, count: int) -> "RigInMeshSpace":
        """The rig with its first mesh coordinates alone; itself, where it has no more."""
        if count >= self.space.size:
            return self
        space = MeshSpace(self.space.rest_vertices, self.space.directions[:count])
        space._mapped = self.source.basis, space.directions, self.linear_map[:, :count].contiguous()
        return RigInMeshSpace(self.source, space)

    def sizable_coordinates(self, least: float) -> int:
        """How many mesh coordinates there are up to the last that coefficients move by `least` of the most, or more.

        A multiple of 16, which matrix products are faster for.
        """
        sizes = self.linear_map.norm(dim=0)
        count = int((sizes >= least * sizes.amax()).nonzero().amax()) + 1
        return min(-(-count // 16) * 16, self.space.size)

    def forward(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch coordinate"]:
        """Controls `(batch, control)` to mesh coordinates `(batch, coordinate)`; 0 at the neutral controls."""
        return self.coordinates_of(self.source.coefficients(controls))

    @torch.no_grad()
    def coordinates_and_vjp(self, controls: Float[Tensor, "batch control"]) -> tuple[Float[Tensor, "batch coordinate"], Vjp]:
        """As `forward`, without a graph, and its vector-Jacobian product (`LinearRig.coefficients_and_vjp`)."""
        coefficients, vjp = self.source.coefficients_and_vjp(controls)
        return self.coordinates_of(coefficients), lambda gradient: vjp(linear(gradient, self.linear_map))

    def coordinates_of(self, coefficients: Float[Tensor, "batch coefficient"]) -> Float[Tensor, "batch coordinate"]:
        """Coefficients `(batch, coefficient)` to mesh coordinates `(batch, coordinate)`."""
        return matmul(coefficients - self.neutral_coefficients, self.linear_map)


def inner_products(
    shapes: Float[Tensor, "shape vertex 3"], others: Float[Tensor, "other vertex 3"]
) -> Float[Tensor, "shape other"]:
    """Inner products of shapes, as three of a ninth of the cost where each moves vertices along one axis."""
    axes, others_axes = axis_by_axis(shapes), axis_by_axis(others)
    if axes is None or others_axes is None:
        return linear(shapes.flatten(1), others.flatten(1))
    products = shapes.new_zeros(len(shapes), len(others))
    for axis in range(3):
        rows, columns = (axes == axis).nonzero(), (others_axes == axis).nonzero()[:, 0]
        products[rows, columns] = shapes[rows[:, 0], :, axis] @ others[columns, :, axis].T
    return products


def _orthonormal(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Orthonormal rows `(coefficient, number)` with the same span, and their singular values `(coefficient,)`, descending."""
    q, r = torch.linalg.qr(rows.double().T)
    left, values, _ = torch.linalg.svd(r)
    return (q @ left[:, : len(values)]).T, values


def _orthonormal_by_axis(basis: Tensor, axes: Tensor) -> tuple[Tensor, Tensor]:
    """As `_orthonormal` for a basis `(coefficient, vertex, 3)`, as three problems of a twenty-seventh of the cost.

    The spans of coefficients of different axes are orthogonal.
    """
    parts = [_orthonormal(basis[axes == axis, :, axis]) for axis in range(3)]
    values, order = torch.cat([sizes for _, sizes in parts]).sort(descending=True, stable=True)
    owners = torch.cat([torch.full((len(sizes),), axis) for axis, (_, sizes) in enumerate(parts)])[order]
    directions = basis.new_zeros(len(order), *basis.shape[1:])
    for axis, (rows, _) in enumerate(parts):
        directions[:, :, axis][owners == axis] = rows.to(basis.dtype)
    return directions, values
