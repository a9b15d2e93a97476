"""A trained inverse on a CPU, with few operations between its matrix products and its weights in one block of memory."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.geometry.kernels.library import Kernels, kernels, kernels_for
from riginv.geometry.products import linear, matmul
from riginv.networks.control_maps import NeutralStart
from riginv.networks.correction import Correction
from riginv.networks.distance_weights import DistanceWeights, axis_by_axis
from riginv.networks.inverse import StagedInverse
from riginv.networks.mlp import ZeroPreserving
from riginv.networks.refinement import LOG_SCALE, SMALLEST
from riginv.runs.huge_pages import in_huge_pages


class _Step(NamedTuple):
    """The weights of a refinement step, as `Correction` has them.

    Those of the residual are divided by the scale of coordinates, and the last ones are multiplied by the preconditioner.
    """

    features: Tensor
    hidden: Tensor
    hidden_bias: Tensor
    gates: Tensor
    gates_bias: Tensor
    mix: Tensor


class PackedInverse:
    """As `StagedInverse.forward` without features, for weights that stay; on a CPU in float32.

    Args:
        network: the trained network.
    """

    def __init__(self, network: StagedInverse) -> None:
        self.rig, self.size = network.rig, network.leading.space.size
        assert isinstance(network.control_map, NeutralStart)
        self.control_map, first = network.control_map, network.stages[0]
        assert isinstance(first, ZeroPreserving) and isinstance(first.network, nn.Sequential)
        self.layers = list(first.network)
        layers = [layer for layer in self.layers if isinstance(layer, nn.Linear)]
        self.conditioner, self.distance_weights, self.weighted = network.preconditioner, network.weights, network.weighted
        self.quasi_newton = network.quasi_newton
        steps = [self._step(correction, network.coordinate_scale) for correction in network.corrections]
        packed = in_huge_pages(
            [each for layer in layers for each in (layer.weight, layer.bias)]
            + [each for step in steps for each in step]
            + [network.leading.linear_map, *self._cluster_maps(network)]
        )
        of_layers, of_steps = packed[: 2 * len(layers)], packed[2 * len(layers) : -3]
        self.weights = dict(zip(map(id, layers), zip(of_layers[::2], of_layers[1::2])))
        self.steps = [_Step(*of_steps[start : start + 6]) for start in range(0, len(of_steps), 6)]
        self.linear_map, self.cluster_map, self.cluster_frame = packed[-3:]
        self.coordinate_scale = network.coordinate_scale
        gradient_scale = torch.ones_like(network.gradient_scale) if self.conditioner else network.gradient_scale
        self.scales = torch.stack([gradient_scale, torch.tensor(SMALLEST), torch.tensor(LOG_SCALE)])
        self.at_zero = self._mlp(torch.zeros(1, self.size))

    @classmethod
    def of(cls, network: nn.Module) -> "PackedInverse | None":
        """None where a network has other parts, is not on a CPU in float32, or there are no kernels."""
        if type(network) is not StagedInverse or network.features or len(network.stages) != 1:
            return None
        if network.quasi_newton and not network.quasi_newton.distance:
            return None
        if not isinstance(network.control_map, NeutralStart) or not network.rig.source.differentiable:
            return None
        tensors = [*network.parameters(), network.control_map.lower, network.rig.linear_map]
        is_single = all(tensor.dtype == torch.float32 and tensor.device.type == "cpu" for tensor in tensors)
        return cls(network) if is_single and kernels() is not None else None

    @torch.no_grad()
    def __call__(self, target: Float[Tensor, "batch coordinate"]) -> Float[Tensor, "batch control"] | None:
        """Mesh coordinates `(batch, coordinate)` to controls `(batch, control)`; None for tensors that kernels do not take."""
        compiled = kernels_for(target)
        if compiled is None or target.dtype != torch.float32 or not len(target):
            return None
        leading = target[:, : self.size]
        raw = self._first(leading / self.coordinate_scale).contiguous()
        for number, step in enumerate(self.steps):
            weights = self.distance_weights if number >= len(self.steps) - self.weighted else None
            raw = self._refined(compiled, step, raw, leading, weights)
        controls = self.control_map.with_derivatives(raw)[0]
        return self.after_distance_steps(target, controls, self.quasi_newton.steps) if self.quasi_newton else controls

    @torch.no_grad()
    def after_distance_steps(
        self, target: Float[Tensor, "batch coordinate"], controls: Float[Tensor, "batch control"], steps: int
    ) -> Float[Tensor, "batch control"]:
        """As `StagedInverse.after_distance_steps`."""
        method, source, neutral = self.quasi_newton, self.rig.source, self.rig.neutral_coefficients
        assert method is not None and method.distance is not None
        distance, of_target = method.distance, matmul(target, self.cluster_frame)

        def evaluate(units: Tensor) -> tuple[Tensor, Callable[[], Tensor]]:
            coefficients, vjp = source.coefficients_and_vjp(method.lower + method.span * units)
            displacements = matmul(coefficients - neutral, self.cluster_map).sub_(of_target)
            weighted = distance.of_displacements(displacements.unflatten(1, (3, -1)))
            return weighted.distance, lambda: method.span * vjp(linear(weighted.error.flatten(1), self.cluster_map))

        return method.minimise(evaluate, controls, steps)

    @staticmethod
    def _cluster_maps(network: StagedInverse) -> tuple[Tensor, Tensor]:
        """From the rig's coefficients and from mesh coordinates to the displacements of clusters, `(row, 3 * cluster)`."""
        if not network.has_distance_steps:
            return network.rig.linear_map[:0], network.rig.linear_map[:0]
        assert network.quasi_newton is not None and network.quasi_newton.distance is not None
        frame = axis_by_axis(network.quasi_newton.distance.frame).flatten(1)
        return network.rig.linear_map @ frame, frame

    def _step(self, correction: nn.Module, coordinate_scale: Tensor) -> _Step:
        assert isinstance(correction, Correction)
        hidden, gates = correction.gate[0], correction.gate[2]
        assert isinstance(hidden, nn.Linear) and isinstance(gates, nn.Linear)
        features = correction.features.weight.detach().clone()
        features[:, : self.size] /= -coordinate_scale
        mix = self.conditioner.step(correction.mix.weight.detach().T).T if self.conditioner else correction.mix.weight
        return _Step(features, hidden.weight, hidden.bias, gates.weight, gates.bias + 1, mix)

    def _first(self, inputs: Tensor) -> Tensor:
        """The first MLP less its outputs at 0, rounded in the same way, which depends on the number of rows."""
        if len(inputs) == 1:
            return self._mlp(inputs) - self.at_zero
        outputs = self._mlp(torch.cat([inputs, torch.zeros_like(inputs[:1])]))
        return outputs[:-1] - outputs[-1:]

    def _mlp(self, values: Tensor) -> Tensor:
        for layer in self.layers:
            if isinstance(layer, nn.Linear):
                values = linear(values, *self.weights[id(layer)])
            elif isinstance(layer, nn.GELU) and (compiled := kernels()) is not None:
                compiled.call("gelu", values.dtype, values, values.numel())
            else:
                values = layer(values)
        return values

    def _refined(self, compiled: Kernels, step: _Step, raw: Tensor, target: Tensor, weights: DistanceWeights | None) -> Tensor:
        """The raw outputs `(batch, control)` after a refinement step."""
        batch, count = raw.shape
        controls, derivatives = self.control_map.with_derivatives(raw)
        coefficients, vjp = self.rig.source.coefficients_and_vjp(controls)
        inputs, gate = raw.new_empty(batch, self.size + count), raw.new_empty(batch, 2 * count + 1)
        residual = inputs[:, : self.size]
        torch.sub(matmul(coefficients - self.rig.neutral_coefficients, self.linear_map), target, out=residual)
        if weights:
            residual.copy_(weights(residual).error)
        gradients = vjp(linear(residual, self.linear_map)).contiguous()
        if self.conditioner:
            gradients = self.conditioner.gradient(gradients * derivatives).contiguous()
        given = (raw, gradients, None if self.conditioner else derivatives, self.scales, count, inputs, self.size, gate, batch)
        compiled.call("refinement_inputs", raw.dtype, *given)
        hidden = linear(gate, step.hidden, step.hidden_bias)
        compiled.call("gelu", hidden.dtype, hidden, hidden.numel())
        gates = linear(hidden, step.gates, step.gates_bias)
        return linear(gates.mul_(linear(inputs, step.features)), step.mix).add_(raw)
