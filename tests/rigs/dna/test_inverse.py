"""GUI controls for raw controls: exact where the table can make them, the nearest where it cannot."""

import csv
import itertools

import numpy as np
import pytest
import torch

from rigs.dna import DnaRig
from rigs.dna.draft import Draft, Row
from rigs.dna.format import read_dna
from rigs.dna.inverse import TableInverse
from tests.rigs.dna.files import draft, shared, written

SYNTHETIC = ("small_v21", "head_v23", "edges_v24", "body_v25", "ml_v26", "radians_v28")


def in_range(inverse: TableInverse, frames: int, seed: int = 0) -> np.ndarray:
    """Random GUI controls within the limits of their segments."""
    random = np.random.default_rng(seed)
    gui = np.repeat(inverse.rest[None], frames, axis=0)
    for control in itertools.chain.from_iterable(inverse.components):
        gui[:, control.gui] = random.uniform(control.ends.min(), control.ends.max(), frames)
    return gui


def brute_force(inverse: TableInverse, raw: np.ndarray, controls: list, steps: int = 41) -> float:
    """The least error over a grid of the controls' values."""
    grids = [np.linspace(control.ends.min(), control.ends.max(), steps) for control in controls]
    gui = np.repeat(inverse.rest[None], steps ** len(grids), axis=0)
    for control, values in zip(controls, np.meshgrid(*grids, indexing="ij")):
        gui[:, control.gui] = values.reshape(-1)
    outputs = np.unique(np.concatenate([control.outputs for control in controls]))
    return float(np.abs(inverse._table(gui) - np.clip(raw, 0, 1))[:, outputs].sum(axis=1).min())


def test_what_the_table_makes_is_found_again():
    inverse = TableInverse(draft().file())
    gui = in_range(inverse, 200)
    answer = inverse(inverse._table(gui))
    assert np.abs(answer.residual).max() < 1e-6
    alone = [0, 1]  # no other GUI control writes what these write, and they are monotone
    assert np.abs(answer.gui - gui)[:, alone].max() < 1e-6
    assert (answer.gui[:, 4] == 0).all()  # the one that nothing uses


def test_controls_that_share_outputs_come_as_near_as_can_be():
    inverse = TableInverse(draft().file())
    raw = np.random.default_rng(1).uniform(0, 1, (12, 12))
    answer = inverse(raw)
    shared_outputs = next(component for component in inverse.components if len(component) == 2)
    outputs = np.unique(np.concatenate([control.outputs for control in shared_outputs]))
    for frame in range(len(raw)):
        found = np.abs(answer.residual[frame, outputs]).sum()
        assert found <= brute_force(inverse, raw[frame], shared_outputs) + 1e-6


def test_a_sum_that_the_clamp_cuts_is_told_from_one_that_it_does_not():
    found = Draft("x", gui=["a", "b"], raw=["r", "s"])
    found.rows = [Row.between("a", "r", (0, 0), (1, 1)), Row.between("b", "r", (0, 0), (1, 1))]
    found.rows += [Row.between("a", "s", (0, 0), (1, 1)), Row.between("b", "s", (0, 0), (1, -1))]
    inverse = TableInverse(found.file())
    wanted = np.array([[1.0, 0.0], [1.0, 0.5], [0.4, 0.4], [0.0, 0.7], [0.5, 0.9]])
    answer = inverse(wanted)
    errors = np.abs(answer.residual).sum(axis=1)
    assert errors[:3].max() < 1e-6
    assert errors == pytest.approx([brute_force(inverse, raw, inverse.components[0], 101) for raw in wanted], abs=1e-6)


def test_a_jump_of_the_table_is_met_on_the_side_that_is_wanted():
    found = Draft("x", gui=["a"], raw=["r"])
    found.rows = [Row("a", "r", 0.0, 0.5, 1.0, 0.0), Row("a", "r", 0.5, 1.0, 1.0, 0.3)]
    inverse = TableInverse(found.file())
    answer = inverse(np.array([[0.5], [0.8], [0.65]]))
    assert np.abs(answer.residual[:2]).max() < 1e-6
    assert abs(answer.residual[2, 0]) == pytest.approx(0.15, abs=1e-6)


@pytest.mark.parametrize("name", SYNTHETIC)
def test_tables_of_others_are_inverted_exactly(name):
    file = read_dna(shared("dna/synthetic", f"{name}.dna"))
    inverse = TableInverse(file)
    answer = inverse(inverse._table(in_range(inverse, 100)))
    assert np.abs(answer.residual).max() < 1e-6
    given = np.load(shared("dna/synthetic", f"{name}.npz"))
    raw = given["raw"][:30]
    ours, theirs = (
        np.abs(inverse._table(gui) - np.clip(raw, 0, 1)).sum(axis=1) for gui in (inverse(raw).gui, given["raw_gui"][:30])
    )
    assert (ours <= theirs + 1e-5).all()  # the reference's guess is never nearer


def test_curves_of_raw_controls_become_curves_of_gui_controls(run, tmp_path):
    path = written(tmp_path / "a.dna", draft().file())
    rig = DnaRig(path, "gui")
    generator = torch.Generator().manual_seed(0)
    controls = rig.lower + (rig.upper - rig.lower) * torch.rand(6, len(rig.controls), generator=generator)
    raw = rig.raw_controls(controls)
    names = DnaRig(path, "raw").control_names
    rows = [["frame", "seconds", *names], *([n, n / 30, *values] for n, values in enumerate(raw.tolist()))]
    with (tmp_path / "curves.csv").open("w", newline="") as target:
        csv.writer(target).writerows(rows)
    outcome = run("gui_dna", "file=a.dna", "curves=curves.csv", "out=gui.csv")
    assert outcome.code == 0, outcome.text
    with (tmp_path / "gui.csv").open(newline="") as source:
        columns, *found = csv.reader(source)
    assert columns == ["frame", "seconds", "g0", "g1", "g2", "g3", "idle"]
    again = torch.tensor([[float(row[columns.index(name)]) for name in rig.control_names] for row in found])
    assert (rig(again) - rig(controls)).norm(dim=2).max() < 1e-2
