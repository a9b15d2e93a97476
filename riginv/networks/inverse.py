"""Networks from mesh coordinates to controls."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.config.values import NonNegativeInt, PositiveInt, Widths
from riginv.errors import InputError
from riginv.networks.base import RigNetwork
from riginv.networks.control_maps import CONTROL_MAPS
from riginv.networks.correction import SQUASH, Correction, Descent, Estimate, StageStart
from riginv.networks.distance_weights import DistanceWeights
from riginv.networks.features import RigFeatures
from riginv.networks.mlp import ZeroPreserving, mlp, small_outputs
from riginv.networks.preconditioning import Preconditioner, weak_poses
from riginv.networks.quasi_newton import QuasiNewton
from riginv.rig.mesh_space import RigInMeshSpace

LEAST_COORDINATE = 1.3e-3  # of the greatest singular value of the map from coefficients to coordinates
START_GAIN = 0.3  # of the last layer: estimates start close to neutral
REFINEMENT_STEPS, WIDTHS = (4, 6), (384, 256)  # without features and with; bundles do not store them
CORRECTION_GAIN = 0.02  # of the last layer where a guess precedes the first MLP: estimates start close to that


class InverseNetwork(RigNetwork, ABC):
    """Maps mesh coordinates `(batch, coordinate)` to controls `(batch, control)`.

    Attributes:
        rig: the rig to invert, in mesh space; not saved with the network's weights.
        leading: the same with the coordinates that the estimates are of, the first ones.
    """

    def __init__(self, rig: RigInMeshSpace, control_map: str) -> None:
        super().__init__()
        if control_map not in CONTROL_MAPS:
            raise InputError(f"network: control_map '{control_map}' is not known; choose one of {', '.join(CONTROL_MAPS)}")
        self.rig = self.leading = rig
        self.control_map = CONTROL_MAPS[control_map](rig.source)

    @abstractmethod
    def each_estimate(self, coordinates: Float[Tensor, "batch coordinate"]) -> Iterator[Estimate]:
        """The estimates of all stages, one for each of `learned_parts`, the last one the most refined."""

    def estimates(self, coordinates: Float[Tensor, "batch coordinate"]) -> list[Estimate]:
        """The estimates of all stages; training uses all of them."""
        return list(self.each_estimate(coordinates))

    def calibrate(self, coordinates: Float[Tensor, "batch coordinate"]) -> None:
        """Set fixed scales from sampled mesh coordinates `(batch, coordinate)`, before training."""

    def estimate(self, raw: Float[Tensor, "batch control"], target: Float[Tensor, "batch coordinate"]) -> Estimate:
        """The estimate from raw outputs `(batch, control)` for mesh coordinates `(batch, coordinate)`."""
        return Estimate(raw, target, self.control_map, self.leading)

    def forward(self, coordinates: Float[Tensor, "batch coordinate"]) -> Float[Tensor, "batch control"]:
        return self.estimates(coordinates)[-1].controls


class DirectInverse(InverseNetwork):
    """One MLP (paper: hidden 2048, 1024, 512, 256, leaky ReLU, tanh scaled to each control's range).

    Args:
        control_map: `range_tanh` as in the paper, or `neutral_start`, which also maps the neutral mesh to the neutral controls.
    """

    def __init__(
        self,
        rig: RigInMeshSpace,
        hidden: Widths = (2048, 1024, 512, 256),
        activation: str = "leaky_relu",
        control_map: str = "range_tanh",
    ) -> None:
        super().__init__(rig, control_map)
        network = mlp(rig.space.size, hidden, len(rig.source.controls), activation)
        self.network = ZeroPreserving(small_outputs(network, START_GAIN)) if control_map == "neutral_start" else network

    def learned_parts(self) -> list[nn.Module]:
        return [self.network]

    def each_estimate(self, coordinates: Float[Tensor, "batch coordinate"]) -> Iterator[Estimate]:
        yield self.estimate(self.network(coordinates), coordinates)

    def forward(self, coordinates: Float[Tensor, "batch coordinate"]) -> Float[Tensor, "batch control"]:
        return self.control_map(self.network(coordinates))


class _Target(NamedTuple):
    """Meshes to invert: mesh coordinates, the scaled inputs of the first stage, and unscaled features; None: they have none."""

    coordinates: Tensor
    inputs: Tensor
    features: Tensor | None


class StagedInverse(InverseNetwork):
    """A learned optimiser: a few MLPs, then refinement steps, each reducing the residual of the one before.

    The input of the first MLP is the mesh. Every further one also gets the residual of the estimate before it, the gradient of
    the squared error through the rig, and the controls so far; so do the refinement steps (`riginv.networks.correction`). Each
    is trained on its own error alone. Gradients and steps are preconditioned (`riginv.networks.preconditioning`). Steps on the
    mean distance that are not learned follow (`riginv.networks.quasi_newton`).

    Where the rig has features they replace mesh coordinates, and a guess from them precedes the first MLP
    (`riginv.networks.features`). Every stage then starts from the best estimate of each mesh so far, and the last refinement
    steps are one that is repeated.

    Args:
        stages: the number of MLPs.
        hidden: their hidden widths.
        refinement_steps: their number; None: `REFINEMENT_STEPS`.
        width: linear features of a refinement step; None: `WIDTHS`.
        gate: hidden width of a refinement step's gate.
        features: whether the rig's features are used, where it has any.
        descent_steps: refinement steps, at most, that are one `Descent`, where features are used.
        distance_steps: steps on the mean distance, after all others, where no features are used.
        quasi_newton_steps: steps on the squared error, after all others, where a Jacobian costs far more than a gradient; there
            every refinement step is a `Descent`, beside such a step.
        preconditioned: whether gradients and steps are, as in all networks but those of old bundles.
        weighted_steps: refinement steps at the end, at most, whose residuals are weighted (`riginv.networks.distance_weights`);
            `distance_steps` do the same at a lower cost.
        coordinates: the number of mesh coordinates that stages see, those of the greatest singular values; None: all where
            features are used, else those that are not below `LEAST_COORDINATE`. Steps on the mean distance see all.
    """

    coordinate_scale: Tensor
    gradient_scale: Tensor

    def __init__(
        self,
        rig: RigInMeshSpace,
        stages: PositiveInt = 1,
        hidden: Widths = (1024, 512),
        refinement_steps: NonNegativeInt | None = None,
        width: PositiveInt | None = None,
        gate: PositiveInt = 128,
        activation: str = "gelu",
        control_map: str = "neutral_start",
        features: bool = True,
        descent_steps: NonNegativeInt = 4,
        distance_steps: NonNegativeInt = 5,
        quasi_newton_steps: NonNegativeInt = 24,
        preconditioned: bool = True,
        weighted_steps: NonNegativeInt = 0,
        coordinates: PositiveInt | None = None,
    ) -> None:
        super().__init__(rig, control_map)
        for name, number in {"stages": stages, "width": width, "gate": gate, "coordinates": coordinates}.items():
            if number is not None and number < 1:
                raise InputError(f"network: {name} is {number}, expected at least 1")
        self.features = RigFeatures(rig) if features and RigFeatures.offered_by(rig) else None
        if coordinates is None:
            coordinates = rig.space.size if self.features else rig.sizable_coordinates(LEAST_COORDINATE)
        self.leading = rig.leading(coordinates)
        size, controls = self.leading.space.size, len(rig.source.controls)
        if refinement_steps is None:
            refinement_steps = REFINEMENT_STEPS[bool(self.features)]
        if width is None:
            width = WIDTHS[bool(self.features)]
        self.preconditioner = Preconditioner(rig, bool(self.features)) if preconditioned else None
        self.quasi_newton = self._quasi_newton(quasi_newton_steps, distance_steps)
        most = refinement_steps if self.quasi_newton else descent_steps
        self.descents = min(most, refinement_steps) if self.features and self.preconditioner else 0
        self.weighted = 0 if self.features else min(weighted_steps, refinement_steps)
        self.weights = DistanceWeights(self.leading.space) if self.weighted else None
        size = self.features.size if self.features else size
        inputs = [size if number == 0 and not self.features else 2 * size + 2 * controls for number in range(stages)]
        gain = CORRECTION_GAIN if self.features else START_GAIN
        self.stages = nn.ModuleList(
            ZeroPreserving(small_outputs(mlp(count, hidden, controls, activation), gain)) for count in inputs
        )
        different = range(refinement_steps - self.descents)
        self.corrections = nn.ModuleList(Correction(size, controls, width, gate) for _ in different)
        self.descent = nn.ModuleList([Descent(controls, width, gate)] if self.descents else [])
        self.register_buffer("coordinate_scale", torch.ones(()))
        self.register_buffer("gradient_scale", torch.ones(controls) if self.features else torch.ones(()))

    def _quasi_newton(self, steps: int, distance_steps: int) -> QuasiNewton | None:
        if self.rig.source.gradient_steps:
            return QuasiNewton(self.rig, steps) if steps else None
        on_distance = distance_steps and not self.features
        return QuasiNewton(self.rig, distance_steps, DistanceWeights(self.rig.space)) if on_distance else None

    def calibrate(self, coordinates: Float[Tensor, "batch coordinate"]) -> None:
        coordinates = coordinates[:, : self.leading.space.size]
        self.coordinate_scale.copy_(_size(coordinates))
        gradient = self.estimate(coordinates.new_zeros(len(coordinates), len(self.rig.source.controls)), coordinates).gradient
        each = gradient.square().mean(dim=0).sqrt().clamp_min(1e-12)
        self.gradient_scale.copy_(each if self.features else _size(gradient))
        if self.features:
            self.features.calibrate(self.rig, coordinates)
        if self.preconditioner:
            controls = self.features.guess(self.features(coordinates)) if self.features else weak_poses(self.rig.source)
            self.preconditioner.calibrate(self.rig, self.control_map, self.control_map.raw_of(controls))
        if self.weights:
            self.weights.calibrate(self.leading.space)
        if self.quasi_newton:
            self.quasi_newton.calibrate(self.rig)

    def learned_parts(self) -> list[nn.Module]:
        return [*self.stages, *self.corrections, *list(self.descent) * self.descents]

    def each_estimate(self, coordinates: Float[Tensor, "batch coordinate"]) -> Iterator[Estimate]:
        target = self._target(coordinates)
        yield from self._each_stage(target, self._guess(target))

    def _target(self, coordinates: Tensor) -> _Target:
        coordinates = coordinates[:, : self.leading.space.size]
        if not self.features:
            return _Target(coordinates, coordinates / self.coordinate_scale, None)
        features = self.features.unscaled(coordinates)
        return _Target(coordinates, self.features.change(self.features.rest, features), features)

    def _guess(self, target: _Target) -> Estimate | None:
        """The estimate before the first stage; None where the rig has no features."""
        if not self.features:
            return None
        return self.estimate(self.control_map.raw_of(self.features.guess(target.inputs)), target.coordinates)

    def _each_stage(self, target: _Target, before: Estimate | None) -> Iterator[Estimate]:
        start: StageStart | None = None
        parts = self.learned_parts()
        for number, stage in enumerate(parts):
            if before is not None:
                latest = self._start(before, is_weighted=number >= len(parts) - self.weighted)
                start = latest if start is None or not self.features else start.or_lower_error(latest)
            raw = stage(target.inputs) if start is None else self._refined(stage, start, target)
            before = self.estimate(raw, target.coordinates)
            yield before

    def _start(self, before: Estimate, is_weighted: bool) -> StageStart:
        """What a stage starts from, after an estimate."""
        error = self.weights(before.error).error if is_weighted and self.weights else before.error
        gradient = before.gradient if error is before.error else before.vjp(error)
        return StageStart(before.raw.detach(), before.detached_coordinates, error, gradient, before.squares)

    def _refined(self, stage: nn.Module, start: StageStart, target: _Target) -> Tensor:
        """The raw outputs `(batch, control)` of a start, refined by a stage."""
        conditioner = self.preconditioner
        gradient = conditioner.gradient(start.gradient) if conditioner else start.gradient / self.gradient_scale
        if isinstance(stage, Descent):
            residual = gradient[:, :0]
        elif self.features and target.features is not None:
            residual = self.features.change(self.features.unscaled(start.coordinates), target.features)
        else:
            residual = start.error / -self.coordinate_scale
        if isinstance(stage, Correction):
            step = stage(residual, gradient, start.raw)
        else:
            step = stage(torch.cat([target.inputs, residual, gradient, torch.tanh(SQUASH * start.raw)], dim=1))
        change = conditioner.step(step) if conditioner else step
        if isinstance(stage, Descent) and self.quasi_newton:
            change = change + self.quasi_newton.stage_step(self.control_map, start.raw, start.gradient)
        return start.raw + change

    def forward(self, coordinates: Float[Tensor, "batch coordinate"]) -> Float[Tensor, "batch control"]:
        """The last estimate; where the rig has features the best one of each mesh, since a stage may fail there."""
        target = self._target(coordinates)
        guess = self._guess(target)
        estimates = list(self._each_stage(target, guess))
        controls = estimates[-1].controls if guess is None else self._best([guess, *estimates])
        return self.quasi_newton(self.rig, controls, coordinates) if self.quasi_newton else controls

    @property
    def has_distance_steps(self) -> bool:
        """Whether the network ends in steps on the mean distance."""
        return self.quasi_newton is not None and self.quasi_newton.distance is not None

    def after_distance_steps(
        self, coordinates: Float[Tensor, "batch coordinate"], controls: Float[Tensor, "batch control"], steps: int
    ) -> Float[Tensor, "batch control"]:
        """Controls `(batch, control)` for mesh coordinates, after steps on the mean distance; of a network that has these."""
        assert self.quasi_newton is not None
        return self.quasi_newton(self.rig, controls, coordinates, steps)

    def _best(self, estimates: list[Estimate]) -> Tensor:
        errors = torch.stack([estimate.squares for estimate in estimates])
        best = errors.argmin(dim=0)
        return torch.stack([estimate.controls for estimate in estimates])[best, torch.arange(best.shape[0], device=best.device)]


def _size(values: Tensor) -> Tensor:
    return values.square().mean().sqrt().clamp_min(1e-12)
