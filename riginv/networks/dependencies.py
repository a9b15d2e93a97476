"""Dependencies of the coefficients of a blendshape rig on controls and shapes, found by posing it.

A primary shape depends on a few controls, a corrective on the shapes that it corrects.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig
from riginv.rig.random_controls import sparse_controls

ACTIVE = 1e-3  # threshold of a weight, or of a control's distance from neutral as a fraction of its range
SWEEP = 8  # values on either side of neutral that each control takes by itself
POSES, MAX_ACTIVE = 4000, 40  # random poses, and their greatest number of active controls
CERTAIN = 0.995  # fraction of the poses with an active corrective in which a shape that it depends on is active


class Dependencies(NamedTuple):
    """The controls and shapes that each coefficient depends on; rows are padded with -1.

    Attributes:
        drivers: controls of each primary shape, `(primary, slot)`.
        parents: primary shapes of each further one, `(corrective, slot)`.
    """

    drivers: Tensor
    parents: Tensor


@torch.no_grad()
def find_dependencies(rig: LinearRig, drivers: int, parents: int) -> Dependencies:
    """The dependencies of a blendshape rig's coefficients, the strongest first.

    Args:
        drivers, parents: the greatest number of each.
    """
    primaries = rig.primary_count
    poses = sparse_controls(
        rig.lower, rig.upper, rig.neutral_controls, min(MAX_ACTIVE, len(rig.controls)), POSES, generator_at(0, "dependencies")
    )
    away = (poses - rig.neutral_controls).abs() > ACTIVE * (rig.upper - rig.lower)
    active = rig.coefficients(poses) > ACTIVE
    responses = _responses(rig)[:, :primaries].T
    needed = _given(active[:, :primaries], away)
    driven = torch.where(responses > ACTIVE, 1 + responses, torch.where(needed >= CERTAIN, needed, 0.0))
    correctives = active[:, primaries:]
    certain = _given(correctives, active[:, :primaries])
    lift = certain - active[:, :primaries].float().mean(dim=0)
    # Certain dependencies first; without any, shapes that are active more often with the corrective than without it.
    follows = torch.where(certain >= CERTAIN, 1 + lift, torch.where((certain >= CERTAIN).any(dim=1)[:, None], 0.0, lift))
    return Dependencies(_strongest(driven, drivers), _strongest(follows, parents))


def _responses(rig: LinearRig) -> Tensor:
    """The greatest weight `(control, coefficient)` that each control causes by itself."""
    greatest = rig.basis.new_zeros(len(rig.controls), len(rig.basis))
    for fraction in torch.linspace(0, 1, SWEEP + 1)[1:].tolist():
        for limit in (rig.lower, rig.upper):
            moved = rig.coefficients(rig.neutral_controls + fraction * torch.diag(limit - rig.neutral_controls))
            greatest = torch.maximum(greatest, moved)
    return greatest


def _given(events: Tensor, conditions: Tensor) -> Tensor:
    """The fraction `(event, condition)` of the poses with each event in which each condition holds; 0 without such poses."""
    together = events.float().T @ conditions.float()
    return together / events.float().sum(dim=0).clamp_min(1)[:, None]


def _strongest(scores: Tensor, most: int) -> Tensor:
    """The columns of the greatest positive scores of each row, `(row, most)`, padded with -1."""
    values, columns = scores.topk(min(most, scores.shape[1]), dim=1)
    strongest = torch.where(values > 0, columns, -1)
    return torch.nn.functional.pad(strongest, (0, most - strongest.shape[1]), value=-1)
