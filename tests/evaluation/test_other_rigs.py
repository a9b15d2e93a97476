"""The benchmark of several rigs: runs, what is not run again, its table, and lists that are wrong."""

import csv

import numpy as np
import pytest
import yaml

from benchmarks import other_rigs
from riginv.errors import InputError
from tests.conftest import SMALL

RIG = {"about": "a sphere", "licence": "MIT", "overrides": SMALL, "takes": {"rise": ["capture=rise.npz"]}}


@pytest.fixture
def folder(tmp_path):
    """A list of the toy with two takes, and of a rig that cannot be read."""
    for name, end in (("rise", 1.0), ("small", 0.3)):
        np.savez(tmp_path / f"{name}.npz", controls=np.linspace(0, end, 4)[:, None].repeat(7, 1), fps=30.0)
    takes = {"rise": ["capture=rise.npz"], "small": ["capture=small.npz"]}
    broken = {**RIG, "overrides": ["rig=dna", "rig.file=none.dna"], "takes": {}}
    (tmp_path / "rigs.yaml").write_text(yaml.safe_dump({"toy": {**RIG, "takes": takes}, "broken": broken}))
    return tmp_path


@pytest.mark.slow
def test_each_rig_is_trained_once_and_stands_in_the_table(folder, capsys):
    arguments = [str(folder), "--out", str(folder / "out"), "--steps", "2", "--set", "trainer.max_steps=2"]
    other_rigs.main([*arguments, "--only", "toy"])
    weights = folder / "out/toy_seed-0/bundle/weights.safetensors"
    written = weights.stat().st_mtime_ns
    capsys.readouterr()
    other_rigs.main(arguments)
    assert weights.stat().st_mtime_ns == written
    printed = capsys.readouterr().out
    assert "toy_seed-0: finished" in printed and "broken_seed-0: failed none.dna: no such file" in printed
    with (folder / "out/other_rigs.csv").open() as file:
        rows = {row["set"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["random combinations", "rig poses", "rise", "small"]
    assert rows["rise"] | {"controls": "7", "coefficients": "12", "vertices": "162", "steps": "2"} == rows["rise"]
    assert float(rows["small"]["neutral_mean_vertex_error_mm"]) < float(rows["rise"]["neutral_mean_vertex_error_mm"])
    assert 0 <= float(rows["small"]["control_precision"]) <= 1 and float(rows["rise"]["roughness"]) >= 0
    assert "| toy | a sphere | MIT |" in (folder / "out/other_rigs.md").read_text()
    with pytest.raises(InputError, match="holds a run with other settings.*choose another --out"):
        other_rigs.main([*arguments[:-1], "trainer.max_steps=3"])


def test_the_table_has_means_over_seeds_and_says_where_a_rig_can_make_the_meshes(tmp_path):
    entry = other_rigs.Entry("toy", tmp_path, (), "a sphere", "MIT", {})
    facts = {"controls": 7, "coefficients": 12, "vertices": 1620, "frames_per_s": 1234.5}
    runs = [{"train/steps": 2, "true_rig": "toy", "rig_poses/optimum_ratio": 2.0} for _ in range(2)]
    for run, error, least in zip(runs, (0.2, 0.4), (0.1, 0.001)):
        run |= {"rig_poses/mean_vertex_error_mm": error, "rig_poses/optimum_mean_vertex_error_mm": least}
    (row,) = other_rigs.rows_of(entry, facts, runs[:1])
    assert row["optimum_ratio"] == 2.0 and row["seeds"] == 1
    other_rigs.write_table(
        tmp_path, list(other_rigs.rows_of(entry, facts, [runs[1], runs[1] | {"rig_poses/mean_vertex_error_mm": 0.2}])), [entry]
    )
    text = (tmp_path / "other_rigs.md").read_text()
    assert "| toy | rig poses | 7 | 12 | 1,620 | 2 | 2 | 0.3 | - | exact | - | - | - | 1,234 |" in text
    assert "| toy | a sphere | MIT |" in text


@pytest.mark.parametrize(
    ("fields", "says"),
    [({**RIG, "licence": None}, "toy: licence is None"), ({**RIG, "take": []}, "toy: take is"), ([], "toy: ")],
)
def test_a_list_that_is_wrong_is_refused(tmp_path, fields, says):
    (tmp_path / "rigs.yaml").write_text(yaml.safe_dump({"toy": fields}))
    with pytest.raises(InputError, match=says):
        other_rigs.read_list(tmp_path)
