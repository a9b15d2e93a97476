"""Random controls, as functions."""

import math

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


def sparse_controls(
    lower: Float[Tensor, " control"],
    upper: Float[Tensor, " control"],
    neutral: Float[Tensor, " control"],
    max_active: int,
    count: int,
    generator: torch.Generator,
) -> Float[Tensor, "count control"]:
    """The paper's random controls: the number of active ones, up to `max_active`, and their values are uniform."""
    active = choose(uniform_counts(count, max_active, generator), len(lower), generator)
    return torch.where(active, uniform(lower, upper, count, generator), neutral)


def choose(counts: Int[Tensor, " batch"], among: int, generator: torch.Generator) -> Bool[Tensor, "batch among"]:
    """Random masks `(batch, among)` with `counts` `(batch,)` entries set in each row, all equally likely."""
    scores = torch.rand(len(counts), among, generator=generator, device=generator.device)
    on_cpu = scores.device.type == "cpu"  # where NumPy sorts thirty times as fast as PyTorch
    ordered = torch.from_numpy(np.sort(scores.numpy(), axis=1)) if on_cpu else scores.sort(dim=1).values
    return scores <= ordered.gather(1, counts[:, None] - 1)


def uniform_counts(count: int, most: int, generator: torch.Generator) -> Tensor:
    """Integers `(count,)`, uniform from 1 to `most`."""
    return torch.randint(1, most + 1, (count,), generator=generator, device=generator.device)


def log_uniform_counts(count: int, most: int, generator: torch.Generator) -> Tensor:
    """Integers `(count,)` from 1 to `most`, log-uniform."""
    exponent = torch.rand(count, generator=generator, device=generator.device) * math.log(most)
    return exponent.exp().round().long().clamp(1, most)


def uniform(
    lower: Float[Tensor, " n"], upper: Float[Tensor, " n"], count: int, generator: torch.Generator
) -> Float[Tensor, "count n"]:
    """Values `(count, n)`, uniform between `lower` and `upper` `(n,)`."""
    draws = torch.rand(count, len(lower), generator=generator, device=generator.device, dtype=lower.dtype)
    return lower + (upper - lower) * draws
