"""Matrix products by the faster of PyTorch's two libraries on a CPU, MKL and oneDNN, with gradients.

PyTorch multiplies float32 by MKL, which leaves half of AVX-512 unused on AMD's processors. oneDNN, which PyTorch uses for
convolutions and compiled code, does not: a product of a batch takes half the time there (docs/experiments.md).
"""

import functools
import platform
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from riginv.geometry.kernels.library import kernels_for

MIN_ROWS = 8  # of the inputs: below it the weights are read from memory for most of the time
CPU_FACTS = Path("/proc/cpuinfo")


def linear(inputs: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """The product `inputs @ weight.T + bias`, as `torch.nn.functional.linear`.

    Args:
        inputs: `(row, input)`.
        weight: `(output, input)`.
        bias: `(output,)`.
    """
    if not _by_onednn(inputs, weight, bias):
        return torch.nn.functional.linear(inputs, weight, bias)
    if torch.is_grad_enabled() and any(each is not None and each.requires_grad for each in (inputs, weight, bias)):
        return _Linear.apply(inputs, weight, bias)
    return _product(inputs, weight, bias)


def matmul(left: Tensor, right: Tensor) -> Tensor:
    """The product of two matrices, as `left @ right`."""
    return linear(left, right.T)


class _Linear(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, inputs: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        ctx.save_for_backward(inputs, weight)
        return _product(inputs, weight, bias)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None, Tensor | None]:
        inputs, weight = ctx.saved_tensors
        of_inputs, of_weight, of_bias = ctx.needs_input_grad
        return (
            matmul(gradient, weight) if of_inputs else None,
            matmul(gradient.T, inputs) if of_weight else None,
            gradient.sum(dim=0) if of_bias else None,
        )


def _product(inputs: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    return torch.ops.mkldnn._linear_pointwise(inputs, weight, bias, "none", [], "")


def _by_onednn(inputs: Tensor, weight: Tensor, bias: Tensor | None) -> bool:
    """Whether oneDNN multiplies these tensors, and faster; PyTorch broadcasts biases, and says which sizes do not fit."""
    given = (inputs, weight) if bias is None else (inputs, weight, bias)
    if torch.compiler.is_compiling() or not prefers_onednn():
        return False
    if kernels_for(*given) is None:  # before sizes are compared, which a traced program would keep
        return False
    if inputs.dtype != torch.float32 or inputs.dim() != 2 or weight.dim() != 2 or not weight.numel() or len(inputs) < MIN_ROWS:
        return False
    fits = inputs.shape[1] == weight.shape[1] and (bias is None or bias.shape == weight.shape[:1])
    return fits and not torch.is_autocast_enabled("cpu")


@functools.cache
def prefers_onednn() -> bool:
    """Whether this is a processor of AMD's with AVX-512, and PyTorch has oneDNN's product."""
    if torch.backends.cpu.get_cpu_capability() != "AVX512" or not torch.backends.mkldnn.is_available():
        return False
    maker = CPU_FACTS.read_text() if CPU_FACTS.is_file() else platform.processor()
    return "AuthenticAMD" in maker and hasattr(torch.ops.mkldnn, "_linear_pointwise")  # not public: a later version may lack it
