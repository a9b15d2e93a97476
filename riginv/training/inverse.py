"""The paper's inverse: a network from meshes to controls, with the loss on the mesh that the rig makes of them (Sec. 3.3)."""

import torch
from torch import Tensor, nn

from riginv.config.values import NonNegativeFloat, NonNegativeInt
from riginv.errors import InputError
from riginv.networks.correction import Estimate
from riginv.networks.inverse import InverseNetwork, StagedInverse
from riginv.rig.batches import PoseBatch, known_controls
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.runs.threads import Workers
from riginv.training.losses import LengthLoss, MeanDistanceLoss
from riginv.training.module import OptimizerFactory, RigModule, ScheduleFactory
from riginv.training.parallel import in_stages, with_gradients

MESH_STAGES = 2  # stages at the end whose loss does not depend on the controls, where no quasi-Newton steps follow


class InverseModule(RigModule):
    """Trains an inverse with a loss on meshes, with gradients through a differentiable rig.

    Args:
        loss: of the estimate of every stage.
        sampled_vertices: the last stage's loss is the mean distance of this many vertices (`MeanDistanceLoss`); 0: `loss`, as
            for the others.
        control_weight: mm of loss for a control that is off by its whole range, on poses of the rig, whose controls are known:
            they decide between several controls that make one mesh. Other meshes are compared by their vertices alone, and so
            are all in the last `MESH_STAGES` stages, unless quasi-Newton steps follow these.

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
        control_weight: NonNegativeFloat = 0.0,
    ) -> None:
        super().__init__(rig, network, make_optimizer, make_schedule)
        if not rig.source.differentiable:
            raise InputError(
                f"no gradient passes through rig '{rig.source.name}', and the mesh loss needs one: train a surrogate of it "
                f"with model=forward, then train the inverse through that with rig=surrogate rig.bundle=DIR"
            )
        self.loss, self.control_weight = loss, control_weight
        steps_follow = isinstance(network, StagedInverse) and network.quasi_newton is not None
        self.mesh_stages = 0 if steps_follow else MESH_STAGES
        self.last_loss = MeanDistanceLoss(network.leading.space, sampled_vertices) if sampled_vertices else loss

    @classmethod
    def can_train_on(cls, rig: LinearRig) -> bool:
        return rig.differentiable

    @property
    def losses(self) -> list[nn.Module]:
        return [self.loss, self.last_loss]

    def loss_and_coordinates(self, batch: PoseBatch) -> tuple[Tensor, Tensor]:
        estimates = self.network.estimates(batch["coordinates"])
        values, gradients = zip(*(self._value_and_gradient(each, number, batch) for number, each in enumerate(estimates)))
        loss = with_gradients(sum(values), list(gradients), [estimate.raw for estimate in estimates])
        return loss, estimates[-1].detached_coordinates

    def loss_on_threads(self, batch: PoseBatch, weights: list[nn.Parameter], workers: Workers) -> tuple[Tensor, Tensor]:
        parts = self.network.learned_parts()
        if len(parts) == 1:
            return super().loss_on_threads(batch, weights, workers)

        estimates = self.network.each_estimate(batch["coordinates"])
        return in_stages(estimates, parts, self._value_and_gradient, batch, workers, self.draw_ahead)

    def _value_and_gradient(self, estimate: Estimate, number: int, batch: PoseBatch) -> tuple[Tensor, Tensor]:
        """The loss of a stage's estimate, and its gradient `(batch, control)` by the raw outputs; neither has a graph."""
        last = len(self.network.learned_parts()) - 1
        value, gradient = value_and_gradient(self.last_loss if number == last else self.loss, estimate)
        known = known_controls(batch)
        if not self.control_weight or known is None or number > max(0, last - self.mesh_stages):
            return value, gradient
        distance, by_raw = control_distance(estimate, known)
        return value + self.control_weight * distance, gradient + self.control_weight * by_raw


def value_and_gradient(loss: nn.Module, estimate: Estimate) -> tuple[Tensor, Tensor]:
    """The loss of an estimate, and its gradient `(batch, control)` by the raw outputs, neither with a graph.

    For a `LengthLoss` the gradient is `estimate.gradient` (already computed for the next stage) times a factor for each mesh;
    for other losses it takes one more vector-Jacobian product.
    """
    if isinstance(loss, LengthLoss):
        factor = 2 / len(estimate.squares) * loss.derivatives(estimate.squares)
        return loss.of_squares(estimate.squares).mean(), factor[:, None] * estimate.gradient
    if isinstance(loss, MeanDistanceLoss):
        value, derivative = loss.value_and_derivative(estimate.error)
        return value, estimate.vjp(derivative)
    with torch.enable_grad():
        coordinates = estimate.detached_coordinates.detach().requires_grad_()
        value = loss(coordinates, estimate.target)
    return value.detach(), estimate.vjp(torch.autograd.grad(value, coordinates)[0])


@torch.no_grad()
def control_distance(estimate: Estimate, known: Tensor) -> tuple[Tensor, Tensor]:
    """The sum of the controls' errors, in fractions of their ranges, as a mean over the batch; neither value has a graph.

    Args:
        known: the true controls `(batch, control)`; rows with NaN do not count.

    Returns:
        The sum, and its gradient `(batch, control)` by the raw outputs.
    """
    rig = estimate.rig.source
    controls, to_raw = estimate.control_map.with_vjp(estimate.raw.detach())
    scale = 1 / ((rig.upper - rig.lower) * len(known))
    change = ((controls - known) * scale).nan_to_num()
    return change.abs().sum(), to_raw(change.sign() * scale)
