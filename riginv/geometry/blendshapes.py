"""Blendshape logic: combinations of weights, and weighted deltas on a mesh."""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from riginv.geometry.kernels.library import Kernels, is_transformed, kernels_for, plain_rows, pure_gradients


def add_to_columns(
    sums: Float[Tensor, "batch column"],
    columns: Int[Tensor, " entry"],
    entries: Float[Tensor, "batch entry"],
    scales: Float[Tensor, "batch entry"] | None = None,
) -> Float[Tensor, "batch column"]:
    """Add entries `(batch, entry)`, each times its scale, to the columns `(entry,)` of `sums` `(batch, column)`, in place."""
    compiled = kernels_for(sums, columns, entries) if scales is None else kernels_for(sums, columns, entries, scales)
    if compiled is None:
        return sums.index_add_(1, columns, entries if scales is None else entries * scales)
    entries, scales = plain_rows(entries), None if scales is None else plain_rows(scales)
    scale_stride = 0 if scales is None else scales.stride(0)
    given = (entries, entries.stride(0), scales, scale_stride, columns.contiguous(), len(columns))
    compiled.call("add_to_columns", sums.dtype, *given, sums, sums.stride(0), len(sums))
    return sums


def screen(activations: Float[Tensor, "batch driver"], sources: Int[Tensor, "shape slot"]) -> Float[Tensor, "batch shape"]:
    """Combine several drivers of each shape as 1 - (1 - a)(1 - b)...: a single driver passes through, and 1 is never exceeded.

    Unlike a clamped sum, this keeps its gradient.

    Args:
        activations: `(batch, driver)` in [0, 1].
        sources: the drivers of each shape, -1 where a slot is empty.

    Returns:
        `(batch, shape)` in [0, 1].
    """
    compiled = kernels_for(activations, sources)
    if compiled is not None:
        return _combined(compiled, activations, sources, True)
    padded = torch.cat([activations, activations.new_zeros(activations.shape[0], 1)], dim=1)
    remaining = 1 - _pick(padded, sources[:, 0])
    for slot in sources.T[1:]:
        remaining = remaining * (1 - _pick(padded, slot))
    return 1 - remaining


def combination_weights(
    weights: Float[Tensor, "batch shape"], members: Int[Tensor, "combination slot"]
) -> Float[Tensor, "batch combination"]:
    """The weight of each combination: the product of the weights of its members.

    Args:
        members: `(combination, slot)` indices of shapes, -1 where a slot is empty.
    """
    compiled = kernels_for(weights, members)
    if compiled is not None:
        return _combined(compiled, weights, members, False)
    padded = torch.cat([weights, weights.new_ones(weights.shape[0], 1)], dim=1)
    product = _pick(padded, members[:, 0])
    for slot in members.T[1:]:
        product = product * _pick(padded, slot)
    return product


def smallest_weights(
    weights: Float[Tensor, "batch shape"], members: Int[Tensor, "combination slot"]
) -> Float[Tensor, "batch combination"]:
    """As `combination_weights`, with the minimum of the members' weights in place of their product."""
    padded = torch.cat([weights, weights.new_full((weights.shape[0], 1), torch.inf)], dim=1)
    smallest = _pick(padded, members[:, 0])
    for slot in members.T[1:]:
        smallest = torch.minimum(smallest, _pick(padded, slot))
    return smallest


def screen_vjp(
    activations: Float[Tensor, "batch driver"], sources: Int[Tensor, "shape slot"], gradient: Float[Tensor, "batch shape"]
) -> Float[Tensor, "batch driver"]:
    """The vector-Jacobian product of `screen`: a gradient `(batch, shape)` to one `(batch, driver)`."""
    return _pull(activations, sources, gradient, True)


def combination_vjp(
    weights: Float[Tensor, "batch shape"],
    members: Int[Tensor, "combination slot"],
    gradient: Float[Tensor, "batch combination"],
) -> Float[Tensor, "batch shape"]:
    """The vector-Jacobian product of `combination_weights`: a gradient `(batch, combination)` to one `(batch, shape)`."""
    return _pull(weights, members, gradient, False)


def screen_derivatives(
    activations: Float[Tensor, "batch driver"], sources: Int[Tensor, "shape slot"]
) -> Float[Tensor, "batch shape slot"]:
    """The derivative `(batch, shape, slot)` of each shape of `screen` by the driver in each slot; 0 in empty slots."""
    compiled = kernels_for(activations, sources)
    if compiled is not None:
        return _derivatives(compiled, activations, sources, True)
    padded = torch.cat([activations, activations.new_zeros(activations.shape[0], 1)], dim=1)
    return _products_of_others(1 - padded[:, sources]) * (sources >= 0)


def combination_derivatives(
    weights: Float[Tensor, "batch shape"], members: Int[Tensor, "combination slot"]
) -> Float[Tensor, "batch combination slot"]:
    """The derivative `(batch, combination, slot)` of each of `combination_weights` by the weight of each member."""
    compiled = kernels_for(weights, members)
    if compiled is not None:
        return _derivatives(compiled, weights, members, False)
    padded = torch.cat([weights, weights.new_ones(weights.shape[0], 1)], dim=1)
    return _products_of_others(padded[:, members]) * (members >= 0)


def apply_deltas(
    rest_vertices: Float[Tensor, "vertex 3"], deltas: Float[Tensor, "shape vertex 3"], weights: Float[Tensor, "batch shape"]
) -> Float[Tensor, "batch vertex 3"]:
    """Add weighted deltas to a rest mesh.

    Args:
        rest_vertices: in mm.
        deltas: in mm at weight 1.
        weights: not clamped.
    """
    return rest_vertices + (weights @ deltas.flatten(1)).unflatten(1, rest_vertices.shape)


def _pick(padded: Tensor, columns: Tensor) -> Tensor:
    """`padded[:, columns]` with a faster gradient; -1 is the last column."""
    return padded.index_select(1, columns % padded.shape[1])


def _products_of_others(factors: Tensor) -> Tensor:
    """For each factor `(batch, product, slot)` the product of the other factors of its product."""
    slots = range(factors.shape[2])
    others = [torch.cat([factors[:, :, :slot], factors[:, :, slot + 1 :]], dim=2).prod(dim=2) for slot in slots]
    return torch.stack(others, dim=2)


def _pull(factors: Tensor, members: Tensor, gradient: Tensor, complement: bool) -> Tensor:
    compiled = kernels_for(factors, members, gradient)
    if compiled is None:
        derivatives = (screen_derivatives if complement else combination_derivatives)(factors, members)
        entries = (derivatives * gradient[:, :, None]).flatten(1)  # 0 in empty slots, so that any column will do
        return add_to_columns(torch.zeros_like(factors), members.flatten().clamp_min(0), entries)
    factors, gradient = plain_rows(factors), plain_rows(gradient)
    pulled = factors.new_empty(factors.shape)
    products, slots = members.shape
    given = (factors, factors.stride(0), factors.shape[1], members.contiguous(), products, slots, int(complement))
    compiled.call("products_pull", factors.dtype, *given, gradient, gradient.stride(0), pulled, len(factors))
    return pulled


def _derivatives(compiled: Kernels, factors: Tensor, members: Tensor, complement: bool) -> Tensor:
    factors, (products, slots) = plain_rows(factors), members.shape
    derivatives = factors.new_empty(len(factors), products, slots)
    given = (factors, factors.stride(0), factors.shape[1], members.contiguous(), products, slots, int(complement))
    compiled.call("products_derivatives", factors.dtype, *given, derivatives, len(factors))
    return derivatives


def _combined(compiled: Kernels, factors: Tensor, members: Tensor, complement: bool) -> Tensor:
    if factors.requires_grad and torch.is_grad_enabled():
        return _CompiledProducts.apply(factors, members, complement, compiled)
    return _multiplied(compiled, factors, members, complement)


def _multiplied(compiled: Kernels, factors: Tensor, members: Tensor, complement: bool) -> Tensor:
    factors = plain_rows(factors)
    products, slots = members.shape
    result = factors.new_empty(len(factors), products)
    given = (factors, factors.stride(0), factors.shape[1], members.contiguous(), products, slots, int(complement))
    compiled.call("products", factors.dtype, *given, result, products, len(factors))
    return result


class _CompiledProducts(torch.autograd.Function):
    """`combination_weights` by a kernel; `screen` where `complement` is set."""

    @staticmethod
    def forward(ctx: Any, factors: Tensor, members: Tensor, complement: bool, compiled: Kernels) -> Tensor:
        ctx.save_for_backward(factors, members)
        ctx.complement = complement
        return _multiplied(compiled, factors, members, complement)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None, None]:
        factors, members = ctx.saved_tensors
        if torch.is_grad_enabled() or is_transformed([gradient]):
            combine = screen if ctx.complement else combination_weights
            return pure_gradients(lambda given: combine(given, members), factors, gradient), None, None, None
        return _pull(factors, members, gradient, ctx.complement), None, None, None
