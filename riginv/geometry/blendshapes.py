"""Blendshape logic: what the weights of shapes do to each other, and to the mesh."""

import torch
from torch import Tensor


def screen(activations: Tensor, sources: Tensor) -> Tensor:
    """Several drivers of one shape, combined as 1 - (1 - a)(1 - b)...: one alone passes through, none exceeds 1.

    Unlike a sum that is clamped, this never loses its gradient.

    Args:
        activations: `(batch, driver)` in [0, 1].
        sources: `(shape, slot)` the drivers of each shape, -1 where a slot is empty.

    Returns:
        `(batch, shape)` in [0, 1].
    """
    padded = torch.cat([activations, activations.new_zeros(activations.shape[0], 1)], dim=1)
    remaining = 1 - _pick(padded, sources[:, 0])
    for slot in sources.T[1:]:
        remaining = remaining * (1 - _pick(padded, slot))
    return 1 - remaining


def combination_weights(weights: Tensor, members: Tensor) -> Tensor:
    """The weight of each combination: the product of the weights of the shapes that it repairs.

    Args:
        weights: `(batch, shape)`.
        members: `(combination, slot)` indices of shapes, -1 where a slot is empty.

    Returns:
        `(batch, combination)`.
    """
    padded = torch.cat([weights, weights.new_ones(weights.shape[0], 1)], dim=1)
    product = _pick(padded, members[:, 0])
    for slot in members.T[1:]:
        product = product * _pick(padded, slot)
    return product


def smallest_weights(weights: Tensor, members: Tensor) -> Tensor:
    """The other rule for combinations: the least of the weights of its shapes; as `combination_weights` otherwise."""
    padded = torch.cat([weights, weights.new_full((weights.shape[0], 1), torch.inf)], dim=1)
    smallest = _pick(padded, members[:, 0])
    for slot in members.T[1:]:
        smallest = torch.minimum(smallest, _pick(padded, slot))
    return smallest


def screen_slopes(activations: Tensor, sources: Tensor) -> Tensor:
    """The derivative `(batch, shape, slot)` of each shape of `screen` by the driver in each slot; 0 in empty slots."""
    padded = torch.cat([activations, activations.new_zeros(activations.shape[0], 1)], dim=1)
    remaining = 1 - padded[:, sources]
    slots = range(sources.shape[1])
    others = [remaining[:, :, [other for other in slots if other != slot]].prod(dim=2) for slot in slots]
    return torch.stack(others, dim=2) * (sources >= 0)


def combination_slopes(weights: Tensor, members: Tensor) -> Tensor:
    """The derivative `(batch, combination, 3)` of each of `combination_weights` by the weight of each member."""
    padded = torch.cat([weights, weights.new_ones(weights.shape[0], 1)], dim=1)
    first, second, third = (padded[:, member] for member in members.T)
    return torch.stack([second * third, first * third, first * second], dim=2) * (members >= 0)


def apply_deltas(rest_vertices: Tensor, deltas: Tensor, weights: Tensor) -> Tensor:
    """Add weighted deltas to a rest mesh.

    Args:
        rest_vertices: `(vertex, 3)`, mm.
        deltas: `(shape, vertex, 3)`, mm at weight 1.
        weights: `(batch, shape)`; not clamped, so extrapolation is the caller's choice.

    Returns:
        `(batch, vertex, 3)`, mm.
    """
    return rest_vertices + (weights @ deltas.flatten(1)).unflatten(1, rest_vertices.shape)


def _pick(padded: Tensor, places: Tensor) -> Tensor:
    """As `padded[:, places]`, whose gradient takes far longer; -1 is the last column."""
    return padded.index_select(1, places % padded.shape[1])
