"""The paper's inverse: a network from meshes to controls, with the loss on the mesh that the rig makes of them (Sec. 3.3)."""

from torch import Tensor, nn

from riginv.errors import InputError
from riginv.losses import MeanDistanceLoss
from riginv.mesh_space import RigInMeshSpace
from riginv.modules.base import OptimizerFactory, RigModule, ScheduleFactory
from riginv.networks.inverse import InverseNetwork
from riginv.sampling.meshes import PoseBatch


class InverseModule(RigModule):
    """Trains an inverse through a differentiable rig, from meshes alone.

    Args:
        loss: on every answer of the network.
        sampled_vertices: the last answer is asked for the mean distance of so many vertices instead; 0: for the same loss.

    Raises:
        InputError: no gradient passes through the rig.
    """

    def __init__(
        self,
        rig: RigInMeshSpace,
        network: InverseNetwork,
        loss: nn.Module,
        make_optimizer: OptimizerFactory,
        make_schedule: ScheduleFactory,
        sampled_vertices: int = 0,
    ) -> None:
        super().__init__(rig, network, make_optimizer, make_schedule)
        if not rig.rig.differentiable:
            raise InputError(
                f"no gradient passes through rig '{rig.rig.name}', and the mesh loss needs one: train a surrogate of it with "
                f"model=forward, then train the inverse through that with rig=surrogate rig.bundle=DIR"
            )
        self.loss = loss
        self.last_loss = MeanDistanceLoss(rig.space.frame, sampled_vertices) if sampled_vertices else loss

    def training_step(self, batch: PoseBatch, batch_idx: int) -> Tensor:
        target = batch["coordinates"]
        *before, last = self.network.answers(target)
        loss = sum(self.loss(answer.coordinates, target) for answer in before) + self.last_loss(last.coordinates, target)
        return self.learn(loss, last.coordinates, target)

    def results(self, batch: PoseBatch) -> Tensor:
        return self.true_rig(self.network(batch["coordinates"]))
