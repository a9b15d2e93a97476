"""The baseline of Holden et al. 2015: the same network, trained on poses of the rig with the loss on their controls."""

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from riginv.rig.batches import PoseBatch
from riginv.rig.interface import LinearRig
from riginv.training.module import RigModule


class HoldenModule(RigModule):
    """Trains an inverse by regression onto the controls that made each mesh; needs no gradient through the rig."""

    @classmethod
    def can_train_on(cls, rig: LinearRig) -> bool:
        return rig.held_out is None  # its results are posed by the rig

    @property
    def losses(self) -> list[nn.Module]:
        return []

    def loss_and_coordinates(self, batch: PoseBatch) -> tuple[Tensor, Tensor]:
        controls = self.network(batch["coordinates"])
        with torch.no_grad():
            coordinates = self.rig(controls)
        return mse_loss(controls, batch["controls"]), coordinates
