"""The paper's inverse: a network from meshes to controls, with the loss on the mesh that the rig makes of them (Sec. 3.3)."""

from typing import Any

import torch
from torch import Tensor, nn

from riginv.config.values import NonNegativeInt
from riginv.errors import InputError
from riginv.networks.inverse import Estimate, InverseNetwork
from riginv.rig.batches import PoseBatch
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.runs.threads import Workers
from riginv.training.losses import LengthLoss, MeanDistanceLoss
from riginv.training.module import OptimizerFactory, RigModule, ScheduleFactory
from riginv.training.parallel import in_stages


class InverseModule(RigModule):
    """Trains an inverse with a loss on meshes, with gradients through a differentiable rig.

    Args:
        loss: of the estimate of every stage.
        sampled_vertices: the last stage's loss is the mean distance of this many vertices; 0: `loss`, as for the others.

    Raises:
        InputError: no gradient passes through the rig.
    """

    network: InverseNetwork

    def __init__(
        self,
        rig: RigInMeshSpace,
        network: InverseNetwork,
        loss: nn.Module,
        make_optimizer: OptimizerFactory,
        make_schedule: ScheduleFactory,
        sampled_vertices: NonNegativeInt = 0,
    ) -> None:
        super().__init__(rig, network, make_optimizer, make_schedule)
        if not rig.source.differentiable:
            raise InputError(
                f"no gradient passes through rig '{rig.source.name}', and the mesh loss needs one: train a surrogate of it "
                f"with model=forward, then train the inverse through that with rig=surrogate rig.bundle=DIR"
            )
        self.loss = loss
        self.last_loss = MeanDistanceLoss(rig.space.directions, sampled_vertices) if sampled_vertices else loss

    @classmethod
    def can_train_on(cls, rig: LinearRig) -> bool:
        return rig.differentiable

    @property
    def losses(self) -> list[nn.Module]:
        return [self.loss, self.last_loss]

    def loss_and_coordinates(self, batch: PoseBatch) -> tuple[Tensor, Tensor]:
        estimates = self.network.estimates(batch["coordinates"])
        values, gradients = zip(*(value_and_gradient(*pair) for pair in zip(self._stage_losses(), estimates)))
        loss = _PrecomputedGradients.apply(sum(values), *gradients, *(estimate.raw for estimate in estimates))
        return loss, estimates[-1].detached_coordinates

    def loss_on_threads(self, batch: PoseBatch, weights: list[nn.Parameter], workers: Workers) -> tuple[Tensor, Tensor]:
        parts = self.network.learned_parts()
        if len(parts) == 1:
            return super().loss_on_threads(batch, weights, workers)

        losses = self._stage_losses()

        def backward(estimate: Estimate, number: int) -> tuple[Tensor, Tensor]:
            return value_and_gradient(losses[number], estimate)

        return in_stages(self.network.each_estimate(batch["coordinates"]), parts, backward, workers, self.draw_ahead)

    def _stage_losses(self) -> list[nn.Module]:
        """The loss of each stage's estimate."""
        return [*(self.loss for _ in self.network.learned_parts()[1:]), self.last_loss]


def value_and_gradient(loss: nn.Module, estimate: Estimate) -> tuple[Tensor, Tensor]:
    """The loss of an estimate, and its gradient `(batch, control)` by the raw outputs, neither with a graph.

    For a `LengthLoss` the gradient is `estimate.gradient` (already computed for the next stage) times a factor for each mesh;
    for other losses it takes one more vector-Jacobian product.
    """
    if isinstance(loss, LengthLoss):
        factor = 2 / len(estimate.squares) * loss.derivatives(estimate.squares)
        return loss.of_squares(estimate.squares).mean(), factor[:, None] * estimate.gradient
    with torch.enable_grad():
        coordinates = estimate.detached_coordinates.detach().requires_grad_()
        value = loss(coordinates, estimate.target)
    return value.detach(), estimate.vjp(torch.autograd.grad(value, coordinates)[0])


class _PrecomputedGradients(torch.autograd.Function):
    """A value with precomputed gradients by the raw outputs."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, *gradients_and_raws: Tensor) -> Tensor:
        ctx.save_for_backward(*gradients_and_raws[: len(gradients_and_raws) // 2])
        return value.clone()

    @staticmethod
    def backward(ctx: Any, scale: Tensor) -> tuple[Tensor | None, ...]:
        gradients = ctx.saved_tensors
        return None, *(None for _ in gradients), *(scale * gradient for gradient in gradients)
