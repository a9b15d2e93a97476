"""Holden et al.: a network trained on the controls of random poses."""

from collections.abc import Iterable
from functools import partial

import torch
from torch import Tensor, nn

from riginv.config.values import PositiveFloat, PositiveInt, Widths
from riginv.errors import InputError
from riginv.methods.base import BatchedMethod
from riginv.methods.network import Network
from riginv.networks.inverse import DirectInverse
from riginv.rig.batches import generator_at
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.sampling.meshes import MeshSampler
from riginv.training.data import PoseDataModule, bare_trainer
from riginv.training.holden import HoldenModule

LEAST_LR = 1e-6  # at the end of training
CALIBRATION_MESHES = 1024


class HoldenNetwork(BatchedMethod):
    """The regression of `model=holden` among the methods: trained here, or loaded.

    Args:
        sampler: the poses that it learns from; they must come with their controls.
        steps, batch_size, lr: of training with Adam; the rate falls along a cosine.
        hidden, activation, control_map: of the network, as in `riginv.networks.inverse.DirectInverse`.
        bundle: one that `python -m riginv.train model=holden` has trained, to be used instead.

    Raises:
        InputError: a number is below 1, or the bundle cannot be used.
    """

    batch_size = 1024
    source = (
        "Holden, Saito, Komura: Learning an inverse rig mapping for character animation (SCA 2015) and Learning inverse "
        "rig mappings by nonlinear regression (TVCG 2016), as the paper compares with: its own network, trained on pairs "
        "sampled from the rig, with the loss on the controls. Changed: meshes come in mesh coordinates; the network "
        "starts at neutral, as ours does, which is owed to a baseline; random poses of ours, and far fewer steps than the "
        "paper's."
    )

    def __init__(
        self,
        rig: RigInMeshSpace,
        sampler: MeshSampler,
        steps: PositiveInt = 4000,
        batch_size: PositiveInt = 64,
        lr: PositiveFloat = 1e-3,
        hidden: Widths = (2048, 1024, 512, 256),
        activation: str = "leaky_relu",
        control_map: str = "neutral_start",
        bundle: str | None = None,
    ) -> None:
        super().__init__(rig)
        if steps < 1:
            raise InputError(f"holden_network: steps is {steps}, expected at least 1")
        self.loaded = Network(rig, bundle) if bundle else None
        if self.loaded:
            self.trained_seconds, self.fingerprint = self.loaded.trained_seconds, self.loaded.fingerprint
            if not isinstance(self.loaded.inverse.network, DirectInverse):
                raise InputError(
                    f"holden_network: {bundle} holds another network: give one of model=holden, or use methods=[network]"
                )
        self.sampler, self.steps, self.batch_size, self.lr = sampler, steps, batch_size, lr
        self.make_network = partial(DirectInverse, hidden=hidden, activation=activation, control_map=control_map)

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        if self.loaded:
            return
        torch.manual_seed(seed)
        self.network = self.make_network(self.rig).to(self.rig.source.dtype)
        sample = self.sampler.sample(CALIBRATION_MESHES, generator_at(seed, "calibration"))
        self.network.calibrate(sample["coordinates"])
        module = HoldenModule(self.rig, self.network, self._optimizer, self._schedule)
        data = PoseDataModule(self.sampler, {}, self.batch_size, self.steps, seed)
        bare_trainer(accelerator="cpu", max_steps=self.steps).fit(module.train(), data)
        self.network.eval()

    def invert(self, meshes: MeshSet) -> Tensor:
        if self.loaded:
            return self.loaded.invert(meshes)
        return super().invert(meshes)

    @torch.no_grad()
    def solve(self, coordinates: Tensor) -> Tensor:
        return self.network(coordinates).clamp(self.rig.source.lower, self.rig.source.upper)

    def _optimizer(self, weights: Iterable[nn.Parameter]) -> torch.optim.Optimizer:
        return torch.optim.Adam(weights, lr=self.lr, fused=True)

    def _schedule(self, optimizer: torch.optim.Optimizer) -> torch.optim.lr_scheduler.LRScheduler:
        return torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, self.steps, LEAST_LR)
