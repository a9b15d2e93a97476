"""Constraints on controls: fixed, static, penalised and paired ones, masks, and policies for names."""

import numpy as np
import pytest
import torch

from riginv.config.typed import convert
from riginv.errors import InputError
from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.tracking.constraints import resolve_constraints
from riginv.tracking.fixed_controls import FixedControlsRig
from riginv.tracking.options import ControlOptions
from riginv.tracking.penalties import PenalisedObjective
from tests.support.inverting import error_mm, inverted
from tests.support.toys import ToyRig


def constraints(rig, **changes):
    return resolve_constraints(rig, convert(changes, ControlOptions, "controls"))


def test_held_controls_stay_and_the_others_make_up_for_them(rig, meshes):
    found = inverted(rig, meshes, controls={"freeze": ["bump0"], "hold": {"side": -0.5}})
    names = rig.control_names
    assert (found.controls[:, names.index("bump0")] == 0).all() and (found.controls[:, names.index("side")] == -0.5).all()
    free = inverted(rig, meshes)
    assert error_mm(rig, free, meshes) < 0.03 < error_mm(rig, found, meshes)


def test_a_held_rig_is_the_rig(rig):
    held = torch.rand(len(rig.controls), generator=generator_at(0, "held"))
    part = FixedControlsRig(rig, torch.tensor([1, 3, 6]), held)
    free = torch.rand(4, 3, generator=generator_at(0, "free"))
    whole = held.repeat(4, 1)
    whole[:, [1, 3, 6]] = free
    assert torch.equal(part(free), rig(whole))
    _, jacobian = part.coefficient_jacobian(free)
    _, expected = rig.coefficient_jacobian(whole)
    assert torch.allclose(jacobian.dense(), expected.dense()[:, :, [1, 3, 6]])


def test_the_gradient_of_preferences_is_that_of_their_cost(rig):
    """Against finite differences in float64, for every kind of preference at once."""
    rig = ToyRig().double()
    penalties = constraints(
        rig, weights={"bump*": 50.0}, symmetric=[["bump0", "bump1"]], exclusive=[["bump2", "side"], ["bump3", "all"]]
    ).penalties
    objective = PenalisedObjective(RigInMeshSpace(rig, MeshSpace.from_rig(rig)), 1e-2, 1e-2, penalties)
    objective.exclusive_penalty, objective.symmetric_penalty = 20.0, 30.0
    units = 0.2 + 0.6 * torch.rand(3, 7, generator=generator_at(0, "units"), dtype=torch.float64)
    _, gradient, _ = objective._prior(units)
    step = 1e-6
    for column in range(7):
        ahead, behind = units.clone(), units.clone()
        ahead[:, column] += step
        behind[:, column] -= step
        derivative = (objective._prior(ahead)[0] - objective._prior(behind)[0]) / (2 * step)
        assert torch.allclose(derivative, gradient[:, column], rtol=1e-4, atol=1e-4)


def test_symmetric_pairs_move_alike_and_exclusive_ones_do_not_meet(rig, meshes):
    free = inverted(rig, meshes).controls
    apart = (free[:, 0] - free[:, 1]).abs().max()
    tied = inverted(rig, meshes, controls={"symmetric": [["bump0", "bump1"]], "symmetric_mm2": 1e3}).controls
    assert apart > 0.1 > 20 * (tied[:, 0] - tied[:, 1]).abs().max()
    both = (free[:, 2] * free[:, 3]).max()
    single = inverted(rig, meshes, controls={"exclusive": [["bump2", "bump3"]], "exclusive_mm2": 100.0}).controls
    assert both > 0.05 and (single[:, 2] * single[:, 3]).max() < 1e-3


def test_dear_controls_are_used_less_and_sparse_ones_fewer(rig, meshes):
    free = inverted(rig, meshes).controls.abs()
    dear = inverted(rig, meshes, controls={"weights": {"bump0": 1e7}}).controls.abs()
    assert dear[:, 0].mean() < 0.5 * free[:, 0].mean() and dear[:, 4].mean() > 0.5 * free[:, 4].mean()
    sparse = inverted(rig, meshes, solver={"sparsity": 0.3}).controls.abs()
    assert (sparse > 1e-3).sum() < (free > 1e-3).sum()


def test_static_controls_have_one_value_and_it_is_nearly_the_best(rig, meshes):
    found = inverted(rig, meshes, controls={"static": ["bump4"]})
    value = found.controls[:, 4]
    assert (value == value[0]).all()
    errors = [
        error_mm(rig, inverted(rig, meshes, controls={"hold": {"bump4": float(share)}}), meshes)
        for share in np.linspace(0, 1, 11)
    ]
    assert error_mm(rig, found, meshes) < 1.1 * min(errors)


def test_names_that_nobody_knows_follow_the_policy(rig, tmp_path):
    for options in ({"freeze": ["jaw*"]}, {"weights": {"jaw": 2.0}}, {"symmetric": [["bump0", "jaw"]]}, {"hold": {"jaw": 0}}):
        with pytest.raises(InputError, match="toy' has no such control"):
            constraints(rig, **options)
        assert bool(constraints(rig, **options, unknown="ignore_new").free.all())
    mask = tmp_path / "mask.json"
    mask.write_text('{"bump0": 0, "bump1": 1, "jaw": 1}')
    for policy, message in (("error", "jaw"), ("ignore_missing", "jaw"), ("ignore_new", "does not name 5 of the 7 controls")):
        with pytest.raises(InputError, match=message):
            constraints(rig, mask=str(mask), unknown=policy)
    assert constraints(rig, mask=str(mask), unknown="ignore_both").free.tolist() == [False] + 6 * [True]
    with pytest.raises(InputError, match="controls.unknown is 'perhaps'"):
        constraints(rig, unknown="perhaps")


@pytest.mark.parametrize(
    "name, content",
    [
        ("a.json", "[1, 2]"),
        ("a.json", '{"bump0": "x"}'),
        ("a.json", '{"bump0": -1}'),
        ("a.json", "{"),
        ("a.yaml", "bump0: !!python/object/apply:os.system ['true']"),
        ("a.csv", "bump0\n"),
    ],
)
def test_a_mask_that_is_none_is_refused(name, content, rig, tmp_path):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=name):
        constraints(rig, mask=str(tmp_path / name))


def test_values_that_cannot_be_meant_are_refused(rig):
    for options in (
        {"hold": {"bump0": 2.0}},
        {"weights": {"bump0": -1}},
        {"symmetric": "both"},
        {"activate": []},
        {"freeze": "bump0"},
    ):
        with pytest.raises(InputError):
            constraints(rig, **options)


def test_sides_are_paired_by_their_names(face):
    names, pairs = face.control_names, constraints(face, symmetric="auto").penalties.symmetric.tolist()
    assert [names.index("browDownLeft"), names.index("browDownRight")] in pairs and len(pairs) > 20
