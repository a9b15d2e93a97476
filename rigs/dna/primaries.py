"""Primary and corrective channels of blendshape rigs."""

import dataclasses

import torch
from torch import Tensor

from rigs.dna.control_sets import ControlSet
from rigs.dna.linear import LinearMap
from rigs.dna.logic.layout import MOST_NUMBERS, Stage
from rigs.dna.model import Model, Pose

HALF = 0.5  # least weight of a channel that a control at its limit drives directly


class Reordered(Stage):
    """Reordered coefficients."""

    order: Tensor

    def __init__(self, stage: Stage, order: Tensor) -> None:
        super().__init__()
        self.stage = stage
        self.keep(order=order)

    def forward(self, pose: Pose) -> Tensor:
        """Coefficients `(batch, coefficient)`."""
        return self.stage(pose).index_select(1, self.order)


@torch.no_grad()
def primaries_first(ends_in: LinearMap, model: Model, chosen: ControlSet) -> tuple[LinearMap, int]:
    """Reorder a linear map so that primary channels come first.

    Returns:
        The map and the number of primary channels; 0 where the rig is no blendshape rig: joints move, weights leave [0, 1], or
        some are not 0 at rest.
    """
    count = len(chosen.controls)
    if not ends_in.channels or model.layout.ml or model.layout.rbf or count * (count + model.layout.total) > MOST_NUMBERS:
        return ends_in, 0
    limits = [[getattr(control, name) for control in chosen.controls] for name in ("neutral", "lower", "upper")]
    neutral, lower, upper = torch.tensor(limits, dtype=torch.float64)

    def weights(controls: Tensor) -> Tensor:
        raw = chosen.mapping(controls)
        return ends_in.stage(Pose(model.logic.channels_of(model.logic.all_controls(raw))[:, model.used_channels], raw))

    if weights(neutral[None]).abs().max() > 0 or (model.logic.psds.factors < 0).any():
        return ends_in, 0
    one = torch.eye(len(neutral), dtype=torch.bool)
    largest = torch.maximum(weights(torch.where(one, upper, neutral)), weights(torch.where(one, lower, neutral))).amax(dim=0)
    sources = model.logic.channel_sources[model.used_channels]
    direct = (largest > HALF) & (sources < model.layout.raw)
    order = torch.cat([direct.nonzero()[:, 0], (~direct).nonzero()[:, 0]])
    names = [ends_in.names[number] for number in order.tolist()]
    stage = Reordered(ends_in.stage, order)
    return dataclasses.replace(ends_in, basis=ends_in.basis[order], names=names, stage=stage), int(direct.sum())
