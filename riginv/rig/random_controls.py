"""Random controls, as functions."""

import math

import torch
from torch import Tensor


def sparse_controls(
    lower: Tensor, upper: Tensor, neutral: Tensor, max_active: int, count: int, generator: torch.Generator
) -> Tensor:
    """The paper's random controls `(count, control)`: their number of active ones, up to `max_active`, and values are uniform.

    Args:
        lower, upper, neutral: `(control,)`.
    """
    active = choose(uniform_counts(count, max_active, generator), len(lower), generator)
    return torch.where(active, uniform(lower, upper, count, generator), neutral)


def choose(counts: Tensor, among: int, generator: torch.Generator) -> Tensor:
    """Random masks `(batch, among)` with `counts` `(batch,)` entries set in each row, all equally likely."""
    scores = torch.rand(len(counts), among, generator=generator, device=generator.device)
    threshold = scores.sort(dim=1).values.gather(1, counts[:, None] - 1)
    return scores <= threshold


def uniform_counts(count: int, most: int, generator: torch.Generator) -> Tensor:
    """Integers `(count,)`, uniform from 1 to `most`."""
    return torch.randint(1, most + 1, (count,), generator=generator, device=generator.device)


def log_uniform_counts(count: int, most: int, generator: torch.Generator) -> Tensor:
    """Integers `(count,)` from 1 to `most`, log-uniform."""
    exponent = torch.rand(count, generator=generator, device=generator.device) * math.log(most)
    return exponent.exp().round().long().clamp(1, most)


def uniform(lower: Tensor, upper: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Values `(count, n)`, uniform between `lower` and `upper` `(n,)`."""
    draws = torch.rand(count, len(lower), generator=generator, device=generator.device, dtype=lower.dtype)
    return lower + (upper - lower) * draws
