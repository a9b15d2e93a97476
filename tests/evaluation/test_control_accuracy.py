"""Whether the right controls were found: measured on rigs whose controls are alike, and through the commands."""

import json
import math

import numpy as np
import pytest
import torch

from riginv.evaluation.control_accuracy import control_accuracy
from riginv.rig.control_effects import ControlEffects
from riginv.rig.interface import Control, LinearRig
from tests.conftest import ROOT
from tests.support.toys import BlackBox, ToyRig

TWINS = ("one", "twin", "opposite", "alike", "far", "still")


class Alike(LinearRig):
    """Two controls of which one moves the mesh half as far as the other, one the other way; one that moves nothing."""

    def __init__(self) -> None:
        toy = ToyRig()
        first, second = toy.basis[0], toy.basis[3]
        basis = torch.stack([first, 0.5 * first, -first, first + 0.5 * second, second, 0 * second])
        super().__init__("alike", [Control(name) for name in TWINS], toy.rest_vertices, toy.faces, basis, TWINS)

    def coefficients(self, controls: torch.Tensor) -> torch.Tensor:
        return controls


@pytest.fixture(scope="module")
def effects():
    return ControlEffects.of_rig(Alike())


def measured(effects, found, true, is_clip=False):
    return control_accuracy(effects, torch.tensor(found), torch.tensor(true), is_clip)


def test_controls_that_the_mesh_cannot_tell_apart_count_as_one(effects):
    assert effects.merged == (("one", "twin", "opposite"),) and effects.without_effect == ("still",)
    assert effects.names == ("one = twin = opposite", "alike", "far")
    exact = measured(effects, [[0.0, 1.0, 0.0, 0.0, 0.2, 0.9]], [[0.6, 0.0, 0.1, 0.0, 0.2, 0.0]])
    assert (exact.precision, exact.recall) == (1, 1) and exact.error < 1e-3
    assert (exact.active, exact.true_active) == (2, 2) and not exact.confused


def test_precision_recall_and_errors(effects):
    found = [[0.5, 0.0, 0.0, 0.0, 0.3, 0.0], [0.0] * 6]
    true = [[0.4, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.6, 0.0, 0.0]]
    one, alike, far = effects.sizes_mm.tolist()
    result = measured(effects, found, true)
    assert (result.precision, result.recall) == (0.5, 0.5)
    assert result.error == pytest.approx((0.1 + 0.3 + 0.6) / 6, abs=1e-6)
    weighted = (0.1 * one + 0.3 * far + 0.6 * alike) / (2 * (one + alike + far))
    assert result.weighted_error == pytest.approx(weighted, abs=1e-6)
    assert math.isnan(result.correlation) and "control_correlation" not in result.figures()
    nothing = measured(effects, [[0.0] * 6], [[0.0] * 6])
    assert "control_precision" not in nothing.figures() and nothing.error == 0


def test_the_control_that_stands_in_for_another_is_named(effects):
    frames = torch.linspace(0.1, 1, 10)
    true, found = torch.zeros(10, 6), torch.zeros(10, 6)
    true[:, 3], true[:, 4] = frames, 0.5
    found[:, 0], found[:, 4] = frames, 0.5 + 0.5 * frames  # alike = one + far / 2: the meshes are the same
    rig = Alike()
    assert float((rig(true) - rig(found)).norm(dim=2).max()) < 1e-4
    result = control_accuracy(effects, found, true, is_clip=True)
    assert {pair.control for pair in result.confused} == {"alike"}
    assert [pair.instead for pair in result.confused] == ["one = twin = opposite", "far"]
    assert sum(pair.fraction for pair in result.confused) == pytest.approx(1, abs=1e-3)
    assert all(pair.frames == 10 for pair in result.confused)
    assert result.correlation == pytest.approx(0, abs=1e-6)


def test_two_wrong_controls_that_do_not_cancel_are_not_confused(effects):
    result = measured(effects, [[0.0, 0.0, 0.0, 0.0, 0.5, 0.0]], [[0.0, 0.0, 0.5, 0.0, 0.0, 0.0]])
    assert all("opposite" not in pair.control or pair.instead != "alike" for pair in result.confused)
    added = measured(effects, [[0.5, 0.0, 0.0, 0.5, 0.0, 0.0]], [[0.0] * 6])  # both too far, none too near
    assert not added.confused


class Sided(LinearRig):
    """A control whose two sides move two shapes, one control for the first of these shapes, and one for another."""

    def __init__(self) -> None:
        toy = ToyRig()
        controls = [Control("side", lower=-1.0), Control("left"), Control("far")]
        super().__init__("sided", controls, toy.rest_vertices, toy.faces, toy.basis[[0, 3, 5]], ["left", "right", "far"])

    def coefficients(self, controls: torch.Tensor) -> torch.Tensor:
        side, left, far = controls.unbind(dim=1)
        return torch.stack([(-side).clamp_min(0) + left, side.clamp_min(0), far], dim=1)


def test_one_side_of_a_control_may_do_what_another_control_does():
    effects = ControlEffects.of_rig(Sided())
    assert effects.merged == (("side-", "left"),) and effects.names == ("side+", "side- = left", "far")
    found, true = [[-0.4, 0.1, 0.0], [0.6, 0.0, 0.0]], [[0.0, 0.5, 0.0], [0.6, 0.0, 0.0]]
    exact = measured(effects, found, true)
    assert (exact.precision, exact.recall) == (1, 1) and exact.error < 1e-6 and not exact.confused
    other_side = measured(effects, [[-0.6, 0.0, 0.0]], [[0.6, 0.0, 0.0]])
    assert (other_side.precision, other_side.recall) == (0, 0)
    assert ControlEffects.of_rig(ToyRig()).names == ToyRig().control_names  # no side is another control


def test_a_rig_that_gives_meshes_alone_has_the_same_effects():
    box, toy = ControlEffects.of_rig(BlackBox()), ControlEffects.of_rig(ToyRig())
    assert torch.allclose(box.gram, toy.gram, rtol=1e-3, atol=1e-3) and box.names == toy.names


def test_every_command_says_whether_the_right_controls_were_found(run, tmp_path):
    outcome = run("train", folder="trained")
    metrics = json.loads((outcome.folder / "metrics.json").read_text())
    assert 0 < metrics["rig_poses/control_precision"] <= 1 and 0 < metrics["rig_poses/control_recall"] <= 1
    assert metrics["rig_poses/control_error_weighted"] < 1 and "rig_poses/control_correlation" not in metrics
    assert "random_combinations/control_error" not in metrics  # nobody knows true controls of these
    assert "Precision and recall: of active controls" in outcome.text


def test_a_clip_of_the_rigs_own_curves_is_held_to_them(run, tmp_path):
    rig, frames = ToyRig(), torch.linspace(0, 6.28, 24)
    curves = torch.zeros(24, len(rig.controls))
    curves[:, 0], curves[:, 3] = 0.5 - 0.5 * frames.cos(), 0.4 * frames.sin().abs()
    np.savez(tmp_path / "take.npz", controls=curves.numpy(), names=np.array(rig.control_names), fps=30.0)
    given = ["rig=toy", f"--config-dir={ROOT / 'tests/conf'}", f"clip={tmp_path / 'take.npz'}", "method=levenberg_marquardt"]
    outcome = run("invert", *given, f"out={tmp_path / 'out'}", "look.sheet=false")
    assert outcome.code == 0, outcome.text
    accuracy = json.loads((tmp_path / "out/curves.json").read_text())["control_accuracy"]
    assert accuracy["control_precision"] > 0.95 and accuracy["control_recall"] > 0.95
    assert accuracy["control_correlation"] > 0.99 and accuracy["control_error"] < 0.01
    assert accuracy["controls_counted_as_one"] == [] == accuracy["controls_without_effect"]
    page = (tmp_path / "out/look.html").read_text()
    assert "precision of controls" in page and "Controls against the true ones" in page
    assert "Controls against the true ones of the clip: precision" in outcome.text
