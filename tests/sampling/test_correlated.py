"""Correlated controls, and which parts of a mixture a rig gets."""

import pytest
import torch

from riginv.errors import InputError
from riginv.networks.surrogate import ControlMLP
from riginv.rig.batches import generator_at
from riginv.rig.interface import Control, LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.sampling.correlated import CorrelatedControls, control_positions, other_sides
from riginv.sampling.meshes import select_for_rig
from tests.support.toys import ToyRig

PARTS = {
    "combinations": {"_target_": "riginv.sampling.meshes.RandomCombinations"},
    "poses": {
        "_target_": "riginv.sampling.meshes.RigPoses",
        "controls": {"_target_": "riginv.sampling.controls.SparseControls"},
    },
    "correlated": {
        "_target_": "riginv.sampling.meshes.RigPoses",
        "controls": {"_target_": "riginv.sampling.correlated.CorrelatedControls"},
    },
}
MIXTURE = {"_target_": "riginv.sampling.meshes.Mixture", "samplers": PARTS, "fractions": dict.fromkeys(PARTS, 1)}


class Row(LinearRig):
    """Eight points in a row, each moved by a control of its own, in millimetres; the last two are a left and a right one."""

    def __init__(self) -> None:
        rest = torch.arange(8.0)[:, None] * torch.tensor([100.0, 0, 0])
        names = [f"point{number}" for number in range(6)] + ["left_point", "right_point"]
        controls = [Control(name, -20.0, 10.0, unit="mm") for name in names]
        basis = torch.eye(8)[..., None] * torch.tensor([0.0, 1, 0])
        super().__init__("row", controls, rest, torch.tensor([[0, 1, 2]]), basis)

    def coefficients(self, controls: torch.Tensor) -> torch.Tensor:
        return controls


@pytest.fixture
def row() -> RigInMeshSpace:
    rig = Row()
    return RigInMeshSpace(rig, MeshSpace.from_rig(rig))


def test_places_are_where_controls_act(row):
    torch.testing.assert_close(control_positions(row), row.source.rest_vertices, atol=1e-3, rtol=0)


def test_neighbours_go_together_and_far_ones_do_not(row):
    controls = CorrelatedControls(row, correlation_length=0.15, sparse_fraction=0).sample(20000, generator_at(0, "row"))
    correlation = torch.corrcoef(controls.T)
    assert correlation[0, 1] > 0.5 > correlation[0, 2] > 0.1 and correlation[0, 5].abs() < 0.05
    assert (controls >= -20).all() and (controls <= 10).all()
    assert controls.amin() < -15 and controls.amax() > 7.5  # each side has its own range


def test_left_and_right_go_alike_oppositely_or_alone(row):
    controls = CorrelatedControls(row, correlation_length=1e-3, sparse_fraction=0, spread=0.1).sample(
        3000, generator_at(0, "row")
    )
    left, right = (torch.where(side > 0, side / 10, side / 20) for side in (controls[:, 6], controls[:, 7]))
    alike, opposite = ((left - right).abs() < 1e-5).float().mean(), ((left + right).abs() < 1e-5).float().mean()
    assert 0.28 < alike < 0.39 and 0.28 < opposite < 0.39


def test_a_share_of_the_poses_is_sparse(row):
    controls = CorrelatedControls(row, sparse_fraction=0.5).sample(4000, generator_at(0, "row"))
    assert 0.45 < ((controls != 0).sum(dim=1) < 8).float().mean() < 0.6


@pytest.mark.parametrize("wrong", [{"correlation_length": 0}, {"spread": -1}, {"sparse_fraction": 2}])
def test_numbers_out_of_range_are_named(row, wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        CorrelatedControls(row, **wrong)


def test_sides_are_found_in_any_spelling():
    names = ("left_hip", "right_hip", "browLeft", "browRight", "nose", "leftover")
    assert other_sides(names) == [1, 0, 3, 2, 4, 5]


def test_a_mixture_holds_what_belongs_to_the_rig():
    selected = select_for_rig(MIXTURE, ToyRig())
    assert list(selected["samplers"]) == list(selected["fractions"]) == ["combinations", "poses"]
    assert list(select_for_rig(MIXTURE, Row())["samplers"]) == ["poses", "correlated"]
    assert select_for_rig(PARTS["combinations"], Row()) == PARTS["combinations"]  # its constructor refuses the rig


def test_a_surrogate_of_millimetres_works_in_shares_and_spreads(row):
    torch.manual_seed(0)
    network = ControlMLP(row.source, hidden=[8])
    controls = torch.rand(500, 8, generator=generator_at(0, "row")) * 30 - 20
    network.set_scales(row.source, controls)
    torch.testing.assert_close(network.spread, controls.square().mean(dim=0).sqrt())
    raw = network.raw(controls / 15)
    torch.testing.assert_close(network(controls), raw * network.spread)
    assert {"middle", "spread"} <= set(network.own_weights())
