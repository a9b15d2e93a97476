"""Networks from mesh coordinates to controls."""

import functools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.mesh_space import RigInMeshSpace
from riginv.networks.base import RigNetwork
from riginv.networks.control_maps import CONTROL_MAPS
from riginv.networks.correction import Correction
from riginv.networks.features import RigFeatures
from riginv.networks.mlp import Anchored, mlp

START_GAIN = 0.3  # of the last layer: answers start close to neutral
CORRECTION_GAIN = 0.02  # of the last layer where a guess stands before the first perceptron: they start close to that


@dataclass(frozen=True)
class Answer:
    """One attempt at the controls.

    Attributes:
        controls: `(batch, control)`.
        rig: which they are of.
    """

    controls: Tensor
    rig: RigInMeshSpace

    @functools.cached_property
    def coordinates(self) -> Tensor:
        """What the rig makes of them, `(batch, coordinate)`; it is posed when this is first asked for."""
        return self.rig(self.controls)


class InverseNetwork(RigNetwork, ABC):
    """Maps mesh coordinates `(batch, coordinate)` to controls `(batch, control)`.

    Attributes:
        rig: the rig that it is the inverse of, in mesh space; not saved with the network's own weights.
    """

    def __init__(self, rig: RigInMeshSpace, control_map: str) -> None:
        super().__init__()
        if control_map not in CONTROL_MAPS:
            raise InputError(f"network: control_map '{control_map}' is not known; choose one of {', '.join(CONTROL_MAPS)}")
        self.rig = rig
        self.control_map = CONTROL_MAPS[control_map](rig.rig)

    @abstractmethod
    def answers(self, coordinates: Tensor) -> list[Answer]:
        """Every attempt, the last one being the answer; training looks at all of them."""

    def calibrate(self, coordinates: Tensor) -> None:
        """Look at a sample of what will come `(batch, coordinate)`, before training, to set fixed scales."""

    def forward(self, coordinates: Tensor) -> Tensor:
        return self.answers(coordinates)[-1].controls


class DirectInverse(InverseNetwork):
    """One perceptron (paper: hidden 2048, 1024, 512, 256, leaky ReLU, tanh scaled to each control's range).

    Args:
        control_map: `range_tanh` as in the paper, or `neutral_start`, which also anchors the neutral mesh.
    """

    def __init__(
        self,
        rig: RigInMeshSpace,
        hidden: Sequence[int] = (2048, 1024, 512, 256),
        activation: str = "leaky_relu",
        control_map: str = "range_tanh",
    ) -> None:
        super().__init__(rig, control_map)
        network = mlp(rig.space.size, hidden, len(rig.rig.controls), activation)
        self.network = Anchored(_start_small(network)) if control_map == "neutral_start" else network

    def learned_parts(self) -> list[nn.Module]:
        return [self.network]

    def answers(self, coordinates: Tensor) -> list[Answer]:
        return [Answer(self.forward(coordinates), self.rig)]

    def forward(self, coordinates: Tensor) -> Tensor:
        return self.control_map(self.network(coordinates))


class StagedInverse(InverseNetwork):
    """A learned optimiser of a few steps: perceptrons in a row, then corrections, each mending what the one before left.

    The first perceptron sees the mesh. Every further stage also sees what its predecessor left: the residual in mesh
    coordinates, the gradient of the squared error through the rig, and the controls so far. Perceptrons find the
    neighbourhood, corrections (`riginv.networks.correction`) come close. Each learns from its own error alone.

    Where the rig offers features they take the place of mesh coordinates, and a linear guess from them that of the first
    predecessor (`riginv.networks.features`).

    Args:
        stages: how many perceptrons.
        hidden: widths of each of them.
        corrections: how many follow.
        width: linear features of a correction.
        gate: hidden width of a correction's gate.
    """

    coordinate_scale: Tensor
    gradient_scale: Tensor

    def __init__(
        self,
        rig: RigInMeshSpace,
        stages: int = 1,
        hidden: Sequence[int] = (1024, 512),
        corrections: int = 6,
        width: int = 384,
        gate: int = 256,
        activation: str = "gelu",
        control_map: str = "neutral_start",
    ) -> None:
        super().__init__(rig, control_map)
        for name, number, least in (
            ("stages", stages, 1),
            ("corrections", corrections, 0),
            ("width", width, 1),
            ("gate", gate, 1),
        ):
            if number < least:
                raise InputError(f"network: {name} is {number}, expected at least {least}")
        size, controls = rig.space.size, len(rig.rig.controls)
        self.features = RigFeatures(rig) if RigFeatures.offered_by(rig) else None
        size = self.features.size if self.features else size
        inputs = [size if number == 0 and not self.features else 2 * size + 2 * controls for number in range(stages)]
        gain = CORRECTION_GAIN if self.features else START_GAIN
        self.stages = nn.ModuleList(Anchored(_start_small(mlp(count, hidden, controls, activation), gain)) for count in inputs)
        self.corrections = nn.ModuleList(Correction(size, controls, width, gate) for _ in range(corrections))
        self.register_buffer("coordinate_scale", torch.ones(()))
        self.register_buffer("gradient_scale", torch.ones(controls) if self.features else torch.ones(()))

    def calibrate(self, coordinates: Tensor) -> None:
        self.coordinate_scale.copy_(_size(coordinates))
        raw = torch.zeros(len(coordinates), len(self.rig.rig.controls), device=coordinates.device, dtype=coordinates.dtype)
        gradient = self._gradient(raw.requires_grad_(), self.rig(self.control_map(raw)) - coordinates)
        if self.features:
            self.features.calibrate(self.rig, coordinates)
            self.gradient_scale.copy_(gradient.square().mean(dim=0).sqrt().clamp_min(1e-12))
        else:
            self.gradient_scale.copy_(_size(gradient))

    def learned_parts(self) -> list[nn.Module]:
        return [*self.stages, *self.corrections]

    @torch.enable_grad()  # the gradient through the rig is an input: it is needed when nothing is trained too
    def answers(self, coordinates: Tensor) -> list[Answer]:
        seen = self._look(coordinates)
        result: list[Answer] = []
        raw, answer = self._guess(seen) if self.features else (None, None)
        for stage in [*self.stages, *self.corrections]:
            raw = stage(seen) if raw is None else self._corrected(stage, raw, answer, seen, coordinates)
            if not raw.requires_grad:
                raw = raw.requires_grad_()
            controls = self.control_map(raw)
            answer = Answer(controls, self.rig)
            result.append(answer)
        return result

    def _corrected(self, stage: nn.Module, raw: Tensor, answer: Answer, seen: Tensor, coordinates: Tensor) -> Tensor:
        """Raw outputs `(batch, control)`, corrected by a stage that sees what the answer to them left."""
        error = answer.coordinates - coordinates
        gradient = self._gradient(raw, error) / self.gradient_scale
        before = raw.detach()
        left = self.features.left(coordinates, answer.coordinates) if self.features else -error / self.coordinate_scale
        left, squashed = left.detach(), torch.tanh(0.3 * before)
        if isinstance(stage, Correction):
            return before + stage(left, gradient, squashed)
        return before + stage(torch.cat([seen, left, gradient, squashed], dim=1))

    def _guess(self, features: Tensor) -> tuple[Tensor, Answer]:
        """The raw outputs and the answer that stand before the first perceptron, where the rig offers features."""
        raw = self.control_map.raw_of(self.features.guess(features)).detach().requires_grad_()
        controls = self.control_map(raw)
        return raw, Answer(controls, self.rig)

    def forward(self, coordinates: Tensor) -> Tensor:
        """The last answer; after a guess from features the best one of each mesh, for there a correction may fail."""
        answers = self.answers(coordinates)
        controls = self._best(answers, coordinates) if self.features else answers[-1].controls
        return controls if torch.is_grad_enabled() else controls.detach()

    def _best(self, answers: list[Answer], coordinates: Tensor) -> Tensor:
        errors = torch.stack([(answer.coordinates - coordinates).square().sum(dim=1) for answer in answers])
        best = errors.argmin(dim=0)
        return torch.stack([answer.controls for answer in answers])[best, torch.arange(best.shape[0], device=best.device)]

    def _look(self, coordinates: Tensor) -> Tensor:
        """What the perceptrons see of a mesh, `(batch, number)`."""
        return self.features(coordinates) if self.features else coordinates / self.coordinate_scale

    def _gradient(self, raw: Tensor, error: Tensor) -> Tensor:
        """The gradient `(batch, control)` of half the squared error with respect to the raw outputs."""
        return torch.autograd.grad(0.5 * error.square().sum(), raw, retain_graph=True)[0]


def _size(values: Tensor) -> Tensor:
    return values.square().mean().sqrt().clamp_min(1e-12)


def _start_small(network: nn.Sequential, gain: float = START_GAIN) -> nn.Sequential:
    with torch.no_grad():
        network[-1].weight.mul_(gain)
        network[-1].bias.zero_()
    return network
