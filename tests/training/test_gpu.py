"""On a GPU kernels equal PyTorch's operations, and replayed steps and draws those that are computed. Skipped without one."""

from functools import partial

import pytest
import torch

from riginv.geometry.curves import curves_and_derivatives, evaluate_curves
from riginv.geometry.kernels.library import pure_torch
from riginv.networks.inverse import StagedInverse
from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.sampling.controls import PlausibleControls
from riginv.sampling.meshes import Mixture, RandomCombinations, RigPoses
from riginv.training.cuda_graphs import GraphedDraw, GraphedStep, NotCapturedError
from riginv.training.inverse import InverseModule
from riginv.training.losses import RmsVertexDistanceLoss
from rigs.face import FaceRig

pytestmark = [
    pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU"),
    pytest.mark.filterwarnings("ignore:Sparse invariant checks:UserWarning"),  # of PyTorch 2.11, though they are turned off
]
ADAM = partial(torch.optim.Adam, lr=2e-3)
CONSTANT = partial(torch.optim.lr_scheduler.ConstantLR, factor=1.0)


@pytest.fixture(scope="module")
def in_space() -> RigInMeshSpace:
    face = FaceRig()
    return RigInMeshSpace(face, MeshSpace.from_rig(face)).to("cuda")


@pytest.fixture
def module(in_space) -> InverseModule:
    found = InverseModule(in_space, StagedInverse(in_space), RmsVertexDistanceLoss(8447), ADAM, CONSTANT, sampled_vertices=512)
    found.network.calibrate(batch_of(in_space, 0)["coordinates"])
    found.log = lambda *args, **kwargs: None
    found.uses_graphs = True
    return found.to("cuda")


def sampler_of(in_space):
    samplers = {"combinations": RandomCombinations(in_space), "poses": RigPoses(in_space, PlausibleControls(in_space))}
    return Mixture(in_space, samplers, {"combinations": 1.0, "poses": 2.0}).to("cuda")


def batch_of(in_space, seed: int):
    return sampler_of(in_space).sample(64, generator_at(0, "gpu", seed, device="cuda"))


@pytest.mark.parametrize("dtype, tolerance", [(torch.float32, 2e-6), (torch.float64, 1e-13)])
@pytest.mark.parametrize("table", ["driver_curves", "ceiling_curves", "limit_curves", "inbetween_curves"])
def test_curves_equal_those_of_pure_torch(in_space, table, dtype, tolerance):
    curves = getattr(in_space.source, table).to("cuda", dtype)
    inputs = torch.empty(40, len(curves), dtype=dtype, device="cuda").uniform_(-1, 2)
    inputs[:3, 0] = torch.tensor([torch.nan, torch.inf, -torch.inf])
    inputs.requires_grad_()
    found = *curves_and_derivatives(curves, inputs), torch.autograd.grad(evaluate_curves(curves, inputs).sum(), inputs)[0]
    with pure_torch():
        expected = (
            *curves_and_derivatives(curves, inputs),
            torch.autograd.grad(evaluate_curves(curves, inputs).sum(), inputs)[0],
        )
    for one, other in zip(found, expected):
        torch.testing.assert_close(one[1:], other[1:], rtol=tolerance, atol=tolerance, equal_nan=True)
    assert found[0][0, 0].isnan()


def test_replayed_steps_have_the_losses_and_gradients_of_computed_ones(module):
    weights = list(module.network.learned_parts()[0].parameters())
    graphed = GraphedStep(module.loss_and_coordinates, batch_of(module.rig, 1), weights)
    for seed in (2, 3):
        batch = batch_of(module.rig, seed)
        loss, coordinates = graphed(batch)
        replayed = [loss.clone(), coordinates.clone(), *(gradient.clone() for gradient in torch.autograd.grad(loss, weights))]
        loss, coordinates = module.loss_and_coordinates(batch)
        computed = loss, coordinates, *torch.autograd.grad(loss, weights)
        sizes = [float(other.detach().norm()) for other in computed]
        differences = [float((one - other).detach().norm()) for one, other in zip(replayed, computed)]
        assert max(differences[:2]) <= 1e-4 * min(sizes[:2])
        assert max(differences[2:]) <= 1e-4 * max(sizes[2:])  # one is 0 but for rounding: what `ZeroPreserving` takes away


def test_a_module_learns_from_replayed_steps(module):
    optimizer = module.configure_optimizers()["optimizer"]
    batch, losses = batch_of(module.rig, 1), []
    for step in range(60):
        optimizer.zero_grad()
        loss = module.training_step(batch, step)
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert module.graphed is not None and module.graphed.calls == 60
    assert losses[-1] < 0.8 * losses[0]


def test_a_step_that_looks_at_a_value_is_computed_without_a_graph(module, capsys):
    compute = module.loss_and_coordinates

    def looking(batch):
        assert float(batch["coordinates"].abs().sum())
        return compute(batch)

    module.loss_and_coordinates = looking
    module.training_step(batch_of(module.rig, 1), 0).backward()
    assert not module.uses_graphs and "not replayed" in capsys.readouterr().out


def test_a_step_that_depends_on_what_a_graph_does_not_see_is_noticed(module):
    scales = iter(range(1, 100))

    def scaled(batch):
        loss, coordinates = module.loss_and_coordinates(batch)
        return next(scales) * loss, coordinates

    graphed = GraphedStep(scaled, batch_of(module.rig, 1), list(module.network.parameters()))
    graphed(batch_of(module.rig, 2))
    with pytest.raises(NotCapturedError, match="another loss"):
        graphed(batch_of(module.rig, 3))


def test_replayed_draws_have_the_bits_of_drawn_batches(in_space):
    sampler = sampler_of(in_space)
    graphed = GraphedDraw(lambda generator: sampler.sample(64, generator), torch.device("cuda"))
    for seed in (5, 6, 5):
        replayed = graphed(seed)
        drawn = sampler.sample(64, torch.Generator("cuda").manual_seed(seed))
        assert all(torch.equal(replayed[key].nan_to_num(), drawn[key].nan_to_num()) for key in drawn)
