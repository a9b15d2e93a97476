"""What the coefficients of a rig depend on, found by posing it: a black box is asked, never opened.

Every blendshape rig has curves of single controls and interactions of few: a primary shape follows a handful of controls, and
what corrects shapes follows the shapes that it corrects. Which ones shows in poses of the rig.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig
from riginv.rig.random_controls import sparse_controls

ACTIVE = 1e-3  # of a weight, or of a control's range away from neutral: below it counts as none
SWEEP = 8  # values on either side of neutral that each control takes alone
POSES, MOST_ACTIVE = 4000, 40  # poses that tell interactions, and how many controls at once
CERTAIN = 0.995  # the share of poses with an active corrective in which a shape that it needs is active


class Dependencies(NamedTuple):
    """Whom each coefficient follows; -1 fills a row up.

    Attributes:
        drivers: controls of each primary shape, `(primary, slot)`.
        parents: primary shapes of each further one, `(corrective, slot)`.
    """

    drivers: Tensor
    parents: Tensor


@torch.no_grad()
def find_dependencies(rig: LinearRig, drivers: int, parents: int) -> Dependencies:
    """Pose a rig with blendshapes to find whom its coefficients follow, the strongest first.

    Args:
        drivers, parents: how many at most.
    """
    primaries = rig.primary_count
    poses = sparse_controls(
        rig.lower, rig.upper, rig.neutral_controls, min(MOST_ACTIVE, len(rig.controls)), POSES, generator_at(0, "dependencies")
    )
    away = (poses - rig.neutral_controls).abs() > ACTIVE * (rig.upper - rig.lower)
    active = rig.coefficients(poses) > ACTIVE
    alone = _responses(rig)[:, :primaries].T
    needed = _given(active[:, :primaries], away)
    alone = torch.where(alone > ACTIVE, 1 + alone, torch.where(needed >= CERTAIN, needed, 0.0))
    correctives = active[:, primaries:]
    certain = _given(correctives, active[:, :primaries])
    lift = certain - active[:, :primaries].float().mean(dim=0)
    # What is certain comes first; among others, what is active more often with the corrective than without it.
    follows = torch.where(certain >= CERTAIN, 1 + lift, torch.where((certain >= CERTAIN).any(dim=1)[:, None], 0.0, lift))
    return Dependencies(_strongest(alone, drivers), _strongest(follows, parents))


def _responses(rig: LinearRig) -> Tensor:
    """The greatest weight `(control, coefficient)` that each control brings about alone."""
    greatest = rig.basis.new_zeros(len(rig.controls), len(rig.basis))
    for share in torch.linspace(0, 1, SWEEP + 1)[1:].tolist():
        for limit in (rig.lower, rig.upper):
            moved = rig.coefficients(rig.neutral_controls + share * torch.diag(limit - rig.neutral_controls))
            greatest = torch.maximum(greatest, moved)
    return greatest


def _given(events: Tensor, conditions: Tensor) -> Tensor:
    """The share `(event, condition)` of the poses with each event in which each condition holds; 0 where it never comes."""
    together = events.float().T @ conditions.float()
    return together / events.float().sum(dim=0).clamp_min(1)[:, None]


def _strongest(scores: Tensor, most: int) -> Tensor:
    """The columns of the greatest positive scores of each row `(row, most)`, -1 where there are fewer."""
    values, columns = scores.topk(min(most, scores.shape[1]), dim=1)
    found = torch.where(values > 0, columns, -1)
    return torch.nn.functional.pad(found, (0, most - found.shape[1]), value=-1)
