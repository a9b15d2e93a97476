"""What riginv.inspect says of priors and of maps of markers."""

from collections.abc import Callable

from tests.clips.test_inspect import TOY, table
from tests.support.toys import ToyRig


def test_priors_are_told(run: Callable, tmp_path):
    assert run("learn_prior", *TOY, "out=prior").code == 0
    outcome = run("inspect", "prior")
    assert outcome.code == 0, outcome.text
    found = table(outcome.text)
    assert found["rig"] == "toy" and found["controls"] == "7" and found["learned from"].endswith("; 0 frames")
    assert ToyRig().control_names[0] in found["free to move"] and found["changes"].startswith("not known")
    assert run("inspect", "prior", *TOY).code == 0
    other = run("inspect", "prior", "rig=face")
    assert other.code == 1 and "Traceback" not in other.text and "toy" in other.text, other.text
    (tmp_path / "prior/prior.safetensors").write_bytes(b"x" * 20)
    damaged = run("inspect", "prior")
    assert damaged.code == 1 and "learn the prior again" in damaged.text, damaged.text


def test_maps_of_markers_are_told(run: Callable, tmp_path):
    markers = "{nose: {vertex: 3}, chin: {triangle: [0, 1, 2], offset_mm: 4, point: [1, 2, 3]}}"
    (tmp_path / "map.yaml").write_text(f"rig: toy\nmarkers: {markers}\n")
    outcome = run("inspect", "map.yaml")
    assert outcome.code == 0, outcome.text
    found = table(outcome.text)
    assert found["rig"] == "toy" and found["markers"] == "2: nose, chin"
    assert found["offsets"] == "1 given, 1 to be calibrated" and found["points"].startswith("1 with")
    assert run("inspect", "map.yaml", *TOY).text.splitlines()[-1] == "its places are on rig 'toy'"
    (tmp_path / "map.yaml").write_text(f"rig: toy\nmarkers: {markers.replace('3}', '9999}')}\n")
    assert "expected numbers of vertices from 0 to 161" in run("inspect", "map.yaml", *TOY).text
    (tmp_path / "map.yaml").write_text("rig: toy\n")
    assert "map.yaml: no markers in it" in run("inspect", "map.yaml").text
