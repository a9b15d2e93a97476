"""A refinement step in training on a CPU: between its matrix products a kernel, and one node in the graph.

Otherwise it has about 30 small operations there and back, which take as long as the products (docs/experiments.md).
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.geometry.kernels.library import kernels_for
from riginv.geometry.products import linear, matmul

SMALLEST = 1e-5  # of a typical gradient: the lower bound of its size under the logarithm
LOG_SCALE = 0.2


def fused_step(
    residual: Float[Tensor, "batch residual"],
    gradient: Float[Tensor, "batch control"],
    raw: Float[Tensor, "batch control"],
    weights: list[Tensor],
) -> Float[Tensor, "batch control"] | None:
    """As `Correction.forward`, with a graph of its weights alone; None where there is no kernel, or more is asked for.

    Args:
        weights: of features, the gate's first layer, its bias, the second layer, its bias, and mixing.
    """
    given = residual, gradient, raw
    if not torch.is_grad_enabled() or any(each.requires_grad for each in given) or torch.is_autocast_enabled("cpu"):
        return None
    if raw.dtype != torch.float32 or kernels_for(*given, *weights) is None:
        return None
    return _FusedStep.apply(*given, *weights)


class _FusedStep(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        residual: Tensor,
        gradient: Tensor,
        raw: Tensor,
        of_features: Tensor,
        of_hidden: Tensor,
        hidden_bias: Tensor,
        of_gates: Tensor,
        gates_bias: Tensor,
        mix: Tensor,
    ) -> Tensor:
        (batch, count), size = raw.shape, residual.shape[1]
        inputs, gate = raw.new_empty(batch, size + count), raw.new_empty(batch, 2 * count + 1)
        inputs[:, :size] = residual
        scales = raw.new_tensor([1.0, SMALLEST, LOG_SCALE])
        given = (raw.contiguous(), gradient.contiguous(), None, scales, count, inputs, size, gate, batch)
        compiled = kernels_for(raw)
        assert compiled is not None
        compiled.call("refinement_inputs", raw.dtype, *given)
        before = linear(gate, of_hidden, hidden_bias)
        hidden = torch.nn.functional.gelu(before)
        gates, features = linear(hidden, of_gates, gates_bias), linear(inputs, of_features)
        gated = torch.addcmul(features, features, gates)
        ctx.save_for_backward(inputs, gate, before, hidden, gates, features, gated, of_gates, mix)
        return linear(gated, mix)

    @staticmethod
    def backward(ctx: Any, by_step: Tensor) -> tuple[Tensor | None, ...]:
        inputs, gate, before, hidden, gates, features, gated, of_gates, mix = ctx.saved_tensors
        by_gated = matmul(by_step, mix)
        by_gates, by_features = by_gated * features, torch.addcmul(by_gated, by_gated, gates)
        by_before = torch.ops.aten.gelu_backward(matmul(by_gates, of_gates), before)
        return (
            *[None] * 3,
            matmul(by_features.T, inputs),
            matmul(by_before.T, gate),
            by_before.sum(dim=0),
            matmul(by_gates.T, hidden),
            by_gates.sum(dim=0),
            matmul(by_step.T, gated),
        )
