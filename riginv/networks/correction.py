"""One step of a learned optimiser: from an estimate and its residual to a change of the controls."""

import functools
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.networks.control_maps import ControlMap
from riginv.networks.mlp import Linear
from riginv.networks.refinement import LOG_SCALE, SMALLEST, fused_step
from riginv.rig.interface import Vjp
from riginv.rig.mesh_space import RigInMeshSpace

START_GAIN = 0.05  # of the last layer: steps start small
SQUASH = 0.3  # of raw outputs, before tanh


class Estimate:
    """An estimate of the controls, with derived quantities that are computed on first use.

    Training uses only `raw` and a gradient by it (`riginv.training.inverse`), so the rig is evaluated without autograd.

    Args:
        raw: the network's raw outputs `(batch, control)`, with its graph.
        target: the target's mesh coordinates `(batch, coordinate)`.
        control_map: from raw outputs to controls.
        rig: the rig of the controls.
    """

    def __init__(
        self,
        raw: Float[Tensor, "batch control"],
        target: Float[Tensor, "batch coordinate"],
        control_map: ControlMap,
        rig: RigInMeshSpace,
    ) -> None:
        self.raw, self.target, self.control_map, self.rig = raw, target, control_map, rig

    def split(self, sizes: list[int]) -> "list[Estimate]":
        """Estimates of parts of the batch, without a graph."""
        rows = zip(self.raw.detach().split(sizes), self.target.split(sizes))
        return [Estimate(raw, target, self.control_map, self.rig) for raw, target in rows]

    @functools.cached_property
    def controls(self) -> Tensor:
        """The controls within the limits, `(batch, control)`, with a graph from the network."""
        return self.control_map(self.raw)

    @functools.cached_property
    def coordinates(self) -> Tensor:
        """The mesh coordinates of the rig at these controls, `(batch, coordinate)`, with a graph from the network."""
        return self.rig(self.controls)

    @functools.cached_property
    def _posed(self) -> tuple[Tensor, Vjp]:
        """`detached_coordinates`, and the vector-Jacobian product from coordinates to raw outputs."""
        controls, to_raw = self.control_map.with_vjp(self.raw.detach())
        coordinates, to_controls = self.rig.coordinates_and_vjp(controls)
        return coordinates, lambda gradient: to_raw(to_controls(gradient))

    @property
    def detached_coordinates(self) -> Tensor:
        """As `coordinates`, without a graph."""
        return self._posed[0]

    @functools.cached_property
    def error(self) -> Tensor:
        """`detached_coordinates` minus the target, `(batch, coordinate)`, without a graph."""
        return self.detached_coordinates - self.target

    @functools.cached_property
    def squares(self) -> Tensor:
        """The squared length of each error, `(batch,)`, without a graph."""
        return self.error.square().sum(dim=1)

    def vjp(self, gradient: Float[Tensor, "batch coordinate"]) -> Float[Tensor, "batch control"]:
        """The vector-Jacobian product from coordinates `(batch, coordinate)` to raw outputs, `(batch, control)`; no graph."""
        return self._posed[1](gradient)

    @functools.cached_property
    def gradient(self) -> Tensor:
        """The gradient of half the squared error by the raw outputs, `(batch, control)`, without a graph."""
        return self.vjp(self.error)


class StageStart(NamedTuple):
    """What a stage starts from, without a graph: the raw outputs of an estimate and what follows from them.

    The error may be weighted (`riginv.networks.distance_weights`); the gradient is its vector-Jacobian product.
    """

    raw: Tensor
    coordinates: Tensor
    error: Tensor
    gradient: Tensor
    squares: Tensor

    def or_lower_error(self, other: "StageStart") -> "StageStart":
        """For each mesh the one with the lower error."""
        better = other.squares < self.squares
        return StageStart(*(torch.where(better.view(-1, *[1] * (b.dim() - 1)), b, a) for a, b in zip(self, other)))


class Correction(nn.Module):
    """A linear map from the residual to a step of the raw outputs, with gates that depend on the mesh.

    Like a Gauss-Newton step it is linear in the residual and its gradient, by a matrix that depends on the controls: `width`
    linear features of both, each multiplied by a gate of the raw outputs and the gradient's direction, then mixed. A zero
    residual gives a zero step, and errors shrink with each step; an MLP that has the residual among its inputs converges to a
    floor instead (docs/experiments.md).

    Args:
        residual: size of the residual.
        controls: number of controls.
        width: number of linear features.
        gate: hidden width of the gate.
    """

    def __init__(self, residual: int, controls: int, width: int, gate: int) -> None:
        super().__init__()
        self.features = Linear(residual + controls, width, bias=False)
        self.gate = nn.Sequential(Linear(2 * controls + 1, gate), nn.GELU(), Linear(gate, width))
        self.mix = Linear(width, controls, bias=False)
        with torch.no_grad():
            self.mix.weight.mul_(START_GAIN)

    def forward(
        self,
        residual: Float[Tensor, "batch residual"],
        gradient: Float[Tensor, "batch control"],
        raw: Float[Tensor, "batch control"],
    ) -> Float[Tensor, "batch control"]:
        """The change of the raw outputs `(batch, control)`.

        Args:
            residual: scaled.
            gradient: of the squared error by the raw outputs, scaled.
            raw: the raw outputs so far.
        """
        hidden, _, last = self.gate
        assert isinstance(hidden, Linear) and isinstance(last, Linear)
        weights = [self.features.weight, hidden.weight, hidden.bias, last.weight, last.bias, self.mix.weight]
        if (step := fused_step(residual, gradient, raw, weights)) is not None:
            return step
        size = gradient.square().mean(dim=1, keepdim=True).sqrt() + SMALLEST
        gates = 1 + self.gate(torch.cat([torch.tanh(SQUASH * raw), gradient / size, LOG_SCALE * size.log()], dim=1))
        return self.mix(gates * self.features(torch.cat([residual, gradient], dim=1)))


class Descent(Correction):
    """A correction that follows the gradient alone, so that its step is 0 at the best controls of any mesh.

    What the rig cannot make of a mesh stays in the residual: a step that follows it ends beside the best controls.

    Args:
        controls, width, gate: as of `Correction`.
    """

    def __init__(self, controls: int, width: int, gate: int) -> None:
        super().__init__(0, controls, width, gate)
