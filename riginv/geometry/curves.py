"""Driven-key curves as animation software evaluates them: cubic Bezier segments, solved exactly and differentiably.

A curve is a list of keys; between two lies a cubic Bezier whose inner points are the right handle of the first and the left
handle of the second. Its value at x is Y(t) where X(t) = x. Outside its keys a curve is constant. Overlapping handles are
shortened first, as Blender and Maya do, so that X is monotone.
"""

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.geometry.kernels.library import Kernels, gpu_kernels_for, kernels_for, plain_rows, pure_gradients, pure_torch

ITERATIONS = 24  # of bracketed Newton, at most; typical curves need 4, vertical tangents more
PLAIN = 3  # Newton steps without bracketing that come first
FIXED = 12  # iterations within `fixed_iterations`
_fixed: ContextVar[int | None] = ContextVar("fixed_iterations", default=None)


class Key(NamedTuple):
    """One key of a curve: its position, and its handles as offsets from it."""

    x: float
    y: float
    left: tuple[float, float] = (0.0, 0.0)
    right: tuple[float, float] = (0.0, 0.0)


Curve = list[Key]
Solve = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]  # from a table and inputs to values and derivatives


def pack_curves(curves: list[Curve]) -> Float[Tensor, "curve segment 9"]:
    """Pack curves into one table for `evaluate_curves`.

    Returns:
        `(curve, segment, 9)` float64: for each Bezier segment its start and width, then the coefficients of
        X(t) = ((a t + b) t + c) t, from 0 to 1, and of Y(t) = ((d t + e) t + f) t + g. Curves with fewer segments than the
        longest are padded with segments that start at infinity.

    Raises:
        ValueError: a curve has fewer than two keys, or keys that do not ascend.
    """
    rows = []
    for number, curve in enumerate(curves):
        if len(curve) < 2 or any(a.x >= b.x for a, b in itertools.pairwise(curve)):
            raise ValueError(f"curve {number} needs at least two keys with ascending x, found x = {[key.x for key in curve]}")
        rows.append([_segment(a, b) for a, b in itertools.pairwise(curve)])
    longest = max(len(row) for row in rows)
    return torch.tensor([row + [[torch.inf] + [0.0] * 8] * (longest - len(row)) for row in rows], dtype=torch.float64)


def evaluate_curves(
    table: Float[Tensor, "curve segment 9"], inputs: Float[Tensor, "batch curve"]
) -> Float[Tensor, "batch curve"]:
    """The value of each curve at its own input.

    Args:
        table: as from `pack_curves`.

    Returns:
        `(batch, curve)`; differentiable in `inputs`. At a key the derivative is that of the segment to its right, at the ends
        that of the end segments, so that a control at its limit has a gradient.
    """
    solve = _kernel_for(table, inputs)
    if solve is not None:
        if inputs.requires_grad and torch.is_grad_enabled():
            return _CompiledCurves.apply(inputs, table, solve)
        return solve(table, inputs)[0]
    x, (start, width, a, b, c, d, e, f, g) = _segments(table, inputs)
    t = _solve(a, b, c, (x - start) / width)
    return ((d * t + e) * t + f) * t + g


@torch.no_grad()
def curves_and_derivatives(
    table: Float[Tensor, "curve segment 9"], inputs: Float[Tensor, "batch curve"]
) -> tuple[Float[Tensor, "batch curve"], Float[Tensor, "batch curve"]]:
    """The value of each curve at its own input, and its derivative there, both `(batch, curve)`; as `evaluate_curves`."""
    solve = _kernel_for(table, inputs)
    if solve is not None:
        return solve(table, inputs)
    x, (start, width, a, b, c, d, e, f, g) = _segments(table, inputs)
    t = _solve(a, b, c, (x - start) / width)
    along = ((3 * a * t + 2 * b) * t + c).clamp_min(torch.finfo(t.dtype).eps) * width
    derivative = ((3 * d * t + 2 * e) * t + f) / along
    return ((d * t + e) * t + f) * t + g, torch.where(x == inputs, derivative, 0.0)


@contextmanager
def fixed_iterations(count: int = FIXED) -> Iterator[None]:
    """A context in which curves are solved in a fixed number of iterations, for tracing: no control flow depends on values."""
    token = _fixed.set(count)
    try:
        with pure_torch():
            yield
    finally:
        _fixed.reset(token)


class _CompiledCurves(torch.autograd.Function):
    """`evaluate_curves` by a kernel, which returns the derivatives along with the values."""

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, table: Tensor, solve: Solve) -> Tensor:
        values, derivatives = solve(table, inputs)
        ctx.save_for_backward(inputs, table, derivatives)
        return values

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        inputs, table, derivatives = ctx.saved_tensors
        if torch.is_grad_enabled():
            return pure_gradients(lambda given: evaluate_curves(table, given), inputs, gradient), None, None
        return gradient * derivatives, None, None


def _kernel_for(table: Tensor, inputs: Tensor) -> Solve | None:
    """The kernel that solves curves on the device of these tensors; None: there is none."""
    if (compiled := kernels_for(table, inputs)) is not None:
        return partial(_solved, compiled)
    if gpu_kernels_for(table, inputs):
        from riginv.geometry.kernels.curves_on_gpu import curves_on_gpu  # Triton is not everywhere

        return lambda table, inputs: curves_on_gpu(table.contiguous(), plain_rows(inputs))
    return None


def _solved(compiled: Kernels, table: Tensor, inputs: Tensor) -> tuple[Tensor, Tensor]:
    """The values and derivatives of curves by a kernel."""
    inputs = plain_rows(inputs)
    (batch, curves), segments = inputs.shape, table.shape[1]
    values, derivatives = (inputs.new_empty(batch, curves) for _ in range(2))
    given = (table.contiguous(), curves, segments, inputs, inputs.stride(0))
    compiled.call("curves", inputs.dtype, *given, values, curves, derivatives, curves, batch)
    return values, derivatives


def _segments(table: Tensor, inputs: Tensor) -> tuple[Tensor, tuple[Tensor, ...]]:
    """The inputs clamped to the curves' ends, and the nine numbers of the segments that they fall into."""
    starts = table[:, :, 0]
    ends = torch.where(starts.isinf(), -torch.inf, starts + table[:, :, 1]).amax(dim=1)
    x = inputs.clamp(starts[:, 0], ends)
    if table.shape[1] == 1:
        return x, table[:, 0].T.contiguous().unbind(0)
    index = (x.detach()[..., None] >= starts[:, 1:]).sum(dim=-1)
    row = torch.arange(len(table), device=table.device) * table.shape[1] + index
    columns = table.flatten(0, 1).T.contiguous()  # contiguous by number: faster arithmetic
    return x, columns.index_select(1, row.flatten()).unflatten(1, row.shape).unbind(0)


def _solve(a: Tensor, b: Tensor, c: Tensor, target: Tensor) -> Tensor:
    """Solve ((a t + b) t + c) t = target for t in [0, 1], where the left side rises from 0 to 1."""
    with torch.no_grad():
        t = target.detach().clone()
        low, high = torch.zeros_like(t), torch.ones_like(t)
        a3, b2 = 3 * a, 2 * b
        tolerance = 4 * torch.finfo(t.dtype).eps
        fixed = _fixed.get() if target.device.type == "cpu" else FIXED  # elsewhere a look at a value waits for the device
        if fixed is None and bool(((((a * t + b) * t + c) * t - target).abs() > tolerance).any()):
            for _ in range(PLAIN):  # nearly always enough, at half the cost of a bracketed step
                error = ((a * t + b) * t + c) * t - target
                t = (t - error / ((a3 * t + b2) * t + c).clamp_min(torch.finfo(t.dtype).eps)).clamp(0, 1)
        for _ in range(ITERATIONS if fixed is None else fixed):
            error = ((a * t + b) * t + c) * t - target
            if fixed is None and bool((error.abs() <= tolerance).all()):
                break
            above = error > 0
            low, high = torch.where(above, low, t), torch.where(above, t, high)
            newton = t - error / ((a3 * t + b2) * t + c)
            t = torch.where((newton >= low) & (newton <= high), newton, (low + high) / 2)
        derivative = ((a3 * t + b2) * t + c).clamp_min(torch.finfo(t.dtype).eps)
    return t + (target - target.detach()) / derivative  # the solution, with its derivative dt/dx = 1 / X'(t)


def _segment(start: Key, end: Key) -> list[float]:
    width = end.x - start.x
    handles = abs(start.right[0]) + abs(end.left[0])
    scale = width / handles if handles > width else 1.0
    first, second = scale * start.right[0] / width, 1 + scale * end.left[0] / width
    y0, y1, y2, y3 = start.y, start.y + scale * start.right[1], end.y + scale * end.left[1], end.y
    in_x = [1 + 3 * (first - second), 3 * (second - 2 * first), 3 * first]
    in_y = [y3 - y0 + 3 * (y1 - y2), 3 * (y0 - 2 * y1 + y2), 3 * (y1 - y0), y0]
    return [start.x, width, *in_x, *in_y]
