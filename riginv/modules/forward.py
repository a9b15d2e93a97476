"""The paper's differentiable approximation of a rig: a network from controls to coefficients, with the loss on the mesh."""

import torch
from torch import Tensor, nn

from riginv.mesh_space import RigInMeshSpace
from riginv.modules.base import OptimizerFactory, RigModule, ScheduleFactory
from riginv.networks.surrogate import SurrogateNetwork
from riginv.sampling.meshes import PoseBatch


class ForwardModule(RigModule):
    """Trains a surrogate of a rig on its poses (Sec. 3.2). It is anchored: neutral controls give the rest mesh."""

    kind = "forward"

    def __init__(
        self,
        rig: RigInMeshSpace,
        network: SurrogateNetwork,
        loss: nn.Module,
        make_optimizer: OptimizerFactory,
        make_schedule: ScheduleFactory,
    ) -> None:
        super().__init__(rig, network, make_optimizer, make_schedule)
        self.loss = loss

    def training_step(self, batch: PoseBatch, batch_idx: int) -> Tensor:
        coordinates = self.coordinates(batch["controls"])
        return self.learn(self.loss(coordinates, batch["coordinates"]), coordinates, batch["coordinates"])

    def coordinates(self, controls: Tensor) -> Tensor:
        """The mesh coordinates `(batch, coordinate)` that the surrogate makes of controls `(batch, control)`."""
        coefficients = self.network(torch.cat([controls, self.rig.rig.neutral_controls[None]]))
        return (coefficients[:-1] - coefficients[-1:]) @ self.rig.linear_map

    def results(self, batch: PoseBatch) -> Tensor:
        return self.rig.space.decode(self.coordinates(batch["controls"]))
