"""Driven-key curves on a GPU, as `source/curves.h` on a CPU: one kernel in place of 300 small operations.

It is written in Triton, which comes with PyTorch for CUDA.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

BLOCK = 256
ITERATIONS = tl.constexpr(60)  # of bracketed Newton, at most; typical curves need 4
NUMBERS = tl.constexpr(9)  # of a segment: start, width, a, b, c of X, d, e, f, g of Y


def curves_on_gpu(table: Tensor, inputs: Tensor) -> tuple[Tensor, Tensor]:
    """The value of each curve at its own input, and its derivative there; as `riginv.geometry.curves.curves_and_derivatives`.

    Args:
        table: `(curve, segment, 9)`, contiguous.
        inputs: `(batch, curve)`, each row contiguous, of the same float32 or float64.
    """
    (batch, curves), segments = inputs.shape, table.shape[1]
    values, derivatives = (inputs.new_empty(batch, curves) for _ in range(2))
    total, epsilon = batch * curves, torch.finfo(inputs.dtype).eps
    if total:
        given = (table, inputs, values, derivatives, total, curves, inputs.stride(0))
        _curves[(triton.cdiv(total, BLOCK),)](*given, segments, epsilon, 0.1 * epsilon**0.5, BLOCK)
    return values, derivatives


@triton.jit
def _curves(
    table,
    inputs,
    values,
    derivatives,
    total,
    curves,
    stride,
    segments: tl.constexpr,
    epsilon: tl.constexpr,
    shortest: tl.constexpr,
    block: tl.constexpr,
):
    place = tl.program_id(0) * block + tl.arange(0, block)
    exists = place < total
    row, curve = place // curves, place % curves
    given = tl.load(inputs + row * stride + curve, mask=exists, other=0.0)
    first = table + curve * segments * NUMBERS

    start = tl.load(first, mask=exists, other=0.0)
    end = start + tl.load(first + 1, mask=exists, other=1.0)
    for segment in range(1, segments):
        begin = tl.load(first + segment * NUMBERS, mask=exists, other=0.0)
        stop = begin + tl.load(first + segment * NUMBERS + 1, mask=exists, other=0.0)
        end = tl.where((begin < float("inf")) & (stop > end), stop, end)
    x = tl.where(given < start, start, given)
    x = tl.where(x > end, end, x)
    chosen = place * 0
    for segment in range(1, segments):
        begin = tl.load(first + segment * NUMBERS, mask=exists, other=0.0)
        chosen = tl.where(x >= begin, segment, chosen)

    part = first + chosen * NUMBERS
    start = tl.load(part, mask=exists, other=0.0)
    width = tl.load(part + 1, mask=exists, other=1.0)
    a = tl.load(part + 2, mask=exists, other=0.0)
    b = tl.load(part + 3, mask=exists, other=0.0)
    c = tl.load(part + 4, mask=exists, other=1.0)  # X(t) = t beyond the last curve
    target = (x - start) / width
    t, low, high = target, target * 0, target * 0 + 1
    number, moving = 0, 1
    while (number < ITERATIONS) & (moving > 0):
        error = ((a * t + b) * t + c) * t - target
        slope = (3 * a * t + 2 * b) * t + c
        high = tl.where(error > 0, t, high)
        low = tl.where(error > 0, low, t)
        newton = t - error / slope
        following = tl.where((newton >= low) & (newton <= high), newton, (low + high) / 2)
        following = tl.where(tl.abs(error) <= 4 * epsilon, t, following)
        moving = tl.max((tl.abs(following - t) > shortest).to(tl.int32))
        t = following
        number += 1

    d = tl.load(part + 5, mask=exists, other=0.0)
    e = tl.load(part + 6, mask=exists, other=0.0)
    f = tl.load(part + 7, mask=exists, other=0.0)
    g = tl.load(part + 8, mask=exists, other=0.0)
    along = (3 * a * t + 2 * b) * t + c
    along = tl.where(along < epsilon, epsilon, along) * width
    rise = ((3 * d * t + 2 * e) * t + f) / along
    tl.store(values + place, tl.where(x == x, ((d * t + e) * t + f) * t + g, x), mask=exists)
    tl.store(derivatives + place, tl.where(x == given, rise, 0.0), mask=exists)
