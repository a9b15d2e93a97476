"""The paper's differentiable approximation of a rig: a network from controls to coefficients, with the loss on the mesh."""

import torch
from torch import Tensor, nn

from riginv.config.values import NonNegativeFloat
from riginv.networks.surrogate import SurrogateNetwork
from riginv.rig.batches import PoseBatch
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.training.losses import CoefficientLoss
from riginv.training.module import OptimizerFactory, RigModule, ScheduleFactory


class ForwardModule(RigModule):
    """Trains a surrogate of a rig on its poses (Sec. 3.2). It is anchored: neutral controls give the rest mesh.

    Args:
        coefficient_weight: of the loss on the rig's own coefficients, where it has blendshapes; the paper has none.
    """

    kind = "forward"

    def __init__(
        self,
        rig: RigInMeshSpace,
        network: SurrogateNetwork,
        loss: nn.Module,
        make_optimizer: OptimizerFactory,
        make_schedule: ScheduleFactory,
        coefficient_weight: NonNegativeFloat = 0.0,
    ) -> None:
        super().__init__(rig, network, make_optimizer, make_schedule)
        self.loss, self.coefficient_weight = loss, coefficient_weight
        self.coefficient_loss = CoefficientLoss(rig.linear_map, rig.space.vertex_count)

    def loss_and_coordinates(self, batch: PoseBatch) -> tuple[Tensor, Tensor]:
        coefficients, neutral = self.coefficients(batch["controls"])
        coordinates = (coefficients - neutral) @ self.rig.linear_map
        loss = self.loss(coordinates, batch["coordinates"])
        if self.coefficient_weight and self.rig.source.has_blendshapes:
            loss = loss + self.coefficient_weight * self.coefficient_loss(coefficients, batch["coefficients"])
        return loss, coordinates.detach()

    def coefficients(self, controls: Tensor) -> tuple[Tensor, Tensor]:
        """The coefficients `(batch, coefficient)` of controls `(batch, control)`, and `(1, coefficient)` at neutral."""
        coefficients = self.network(torch.cat([controls, self.rig.source.neutral_controls[None]]))
        return coefficients[:-1], coefficients[-1:]

    def results(self, batch: PoseBatch) -> Tensor:
        coefficients, neutral = self.coefficients(batch["controls"])
        return self.rig.space.decode((coefficients - neutral) @ self.rig.linear_map)
