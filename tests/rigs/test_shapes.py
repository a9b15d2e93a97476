"""A folder of shapes as a rig: its names by the convention, its meshes against plain NumPy."""

import inspect
import re
import runpy

import numpy as np
import pytest
import torch
import yaml
from safetensors.numpy import save_file

from riginv.errors import InputError
from riginv.rig.contract import check_rig
from riginv.rig.interface import LinearRig
from rigs.shapes import ShapesRig
from rigs.shapes.build import build_geometry
from rigs.shapes.names import read_names
from tests.conftest import ROOT
from tests.support.sculpts import POINTS, offset, write_folder, write_obj, write_ply

pytestmark = pytest.mark.usefixtures("own_cache")


def posed(rig: ShapesRig, **weights: float) -> np.ndarray:
    controls = torch.zeros(1, len(rig.controls), dtype=torch.float64)
    for name, weight in weights.items():
        controls[0, rig.control_names.index(name)] = weight
    return rig.double()(controls)[0].numpy()


def test_names_are_taken_by_the_convention():
    names = (
        "a a50 a25 b a_b a50_b a_b_c c a_b50 a_c50 c50 brow_up brow_up_L brow_up_a AU12 AU1 AU2 x50 a5 a00 a150 up_a_up".split()
    )
    found = read_names(names)
    assert found.primaries == sorted("a b c brow_up brow_up_L AU12 AU1 AU2 x50 a5 a00 a150 up_a_up".split())
    assert found.inbetweens == {"a50": ("a", 0.5), "a25": ("a", 0.25), "c50": ("c", 0.5)}
    combinations = {"a_b": ("a", "b"), "a50_b": ("a50", "b"), "a_c50": ("a", "c50"), "a_b_c": ("a", "b", "c")}
    assert found.combinations == {**combinations, "brow_up_a": ("brow_up", "a")}
    assert found.combination_inbetweens == {"a_b50": ("a_b", 0.5)}
    assert sorted(found.names) == sorted(names)
    assert found.pose("a50_b") == {"a": 0.5, "b": 1.0} and found.pose("a_b50") == {"a": 0.5, "b": 0.5}


def test_the_longest_part_is_taken_first_and_a_shape_is_never_combined_with_itself():
    found = read_names("up brow brow_raise raise_lid lid brow_raise_lid up_up up_up50 up50".split())
    assert found.combinations == {"brow_raise_lid": ("brow_raise", "lid")}
    assert found.inbetweens == {"up50": ("up", 0.5), "up_up50": ("up_up", 0.5)}
    assert len(read_names(["a", "a_a", "_".join("a" * 120) + "_x"]).primaries) == 3  # and quickly


def test_one_combination_cannot_stand_there_twice():
    with pytest.raises(InputError, match="'a_b' and 'b_a' both combine"):
        read_names(["a", "b", "a_b", "b_a"])


def test_every_sculpt_is_made_exactly_where_it_belongs_and_linear_paths_lead_there(tmp_path):
    names = ["a", "a25", "a50", "b", "c", "a_b", "a_b_c", "a50_b", "a_b50", "brow_L"]
    sculpts = {name: POINTS + offset(number) for number, name in enumerate(names)}
    for combination in ("product", "min"):
        rig = ShapesRig(str(write_folder(tmp_path / "rig", **sculpts)), combination=combination)
        assert rig.control_names == ("a", "b", "brow_L", "c") and rig.primary_count == 4
        np.testing.assert_allclose(posed(rig), POINTS, atol=1e-6)
        for name in names:
            np.testing.assert_allclose(posed(rig, **rig.shapes.pose(name)), sculpts[name], atol=1e-5, err_msg=name)
        knots = {0.0: POINTS, 0.25: sculpts["a25"], 0.5: sculpts["a50"], 1.0: sculpts["a"]}
        for weight in np.linspace(0, 1, 21):
            left = max(knot for knot in knots if knot <= weight)
            right = min(knot for knot in knots if knot >= weight)
            share = (weight - left) / (right - left) if right > left else 0
            expected = (1 - share) * knots[left] + share * knots[right]
            np.testing.assert_allclose(posed(rig, a=weight), expected, atol=1e-5)
        check_rig(ShapesRig(str(tmp_path / "rig"), combination=combination))


@pytest.mark.parametrize(("combination", "rule"), [("product", np.prod), ("min", np.min)])
def test_between_sculpts_combinations_follow_their_rule(tmp_path, combination, rule):
    a, b, c, ab, abc = (offset(number) for number in range(5))
    shapes = {"a": POINTS + a, "b": POINTS + b, "c": POINTS + c, "a_b": POINTS + ab, "a_b_c": POINTS + abc}
    rig = ShapesRig(str(write_folder(tmp_path / "rig", **shapes)), combination=combination)
    weights = np.random.default_rng(9).random((20, 3))
    pair = ab - a - b
    triple = abc - a - b - c - pair
    for x, y, z in weights:
        expected = POINTS + x * a + y * b + z * c + rule([x, y]) * pair + rule([x, y, z]) * triple
        np.testing.assert_allclose(posed(rig, a=x, b=y, c=z), expected, atol=1e-5)


@pytest.mark.parametrize("combination", ["product", "min"])
@pytest.mark.parametrize("names", ["a a25 a50 b c a_b a_b_c a50_b a_b50", "a b c a_b a_b_c", "a b"])
def test_the_jacobian_is_the_one_of_automatic_differentiation(tmp_path, names, combination):
    write_folder(tmp_path, **{name: POINTS + offset(number) for number, name in enumerate(names.split())})
    rig = ShapesRig(str(tmp_path), combination=combination).double()
    controls = torch.rand(30, len(rig.controls), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    controls[0] = 0.0
    found, jacobian = rig.coefficient_jacobian(controls)
    expected, by_autograd = LinearRig.coefficient_jacobian(rig, controls)
    torch.testing.assert_close(found, expected)
    rows = slice(1, None) if combination == "min" else slice(None)  # at rest all weights are the smallest
    torch.testing.assert_close(jacobian.dense()[rows], by_autograd.dense()[rows])
    gradient = torch.rand_like(found)
    torch.testing.assert_close(jacobian.vjp(gradient)[rows], by_autograd.vjp(gradient)[rows])


def test_deltas_come_from_arrays_and_from_meshes_that_are_said_to_hold_them(tmp_path):
    a, b, c, ab, bc, d = (offset(number) for number in range(6))
    folder = write_folder(tmp_path / "rig", a=POINTS + a, d=d)
    np.save(folder / "b.npy", b)
    np.savez(folder / "table.npz", c=c.astype(np.float32), a_b=ab)
    save_file({"b_c": bc}, folder / "more.safetensors")
    rig = ShapesRig(str(folder), deltas=["d"], unit_mm=10)
    assert rig.coefficient_names == ("a", "b", "c", "d", "a_b", "b_c")
    np.testing.assert_allclose(rig.basis.numpy(), 10 * np.stack([a, b, c, d, ab, bc]), atol=1e-5)
    np.testing.assert_allclose(rig.rest_vertices.numpy(), 10 * POINTS, atol=1e-6)
    expected = 10 * (POINTS + 0.5 * a + 0.4 * b + 0.2 * ab)
    np.testing.assert_allclose(posed(rig, a=0.5, b=0.4), expected, atol=1e-5)  # a combination's deltas stand as they are
    everything = ShapesRig(str(write_folder(tmp_path / "deltas", a=a)), deltas=True)
    np.testing.assert_allclose(everything.basis[0].numpy(), a, atol=1e-6)


def test_names_can_be_chosen_and_the_convention_switched_off(tmp_path):
    folder = write_folder(tmp_path / "rig", a=POINTS + offset(0), b=POINTS + offset(1), a_b=POINTS + offset(2), a50=POINTS)
    (folder / "neutral.obj").rename(folder / "rest.obj")
    write_ply(folder / "c.ply", POINTS, "ascii")
    (folder / "notes.txt").write_text("no shape")
    (folder / "._a.obj").write_text("left by a file manager")
    rig = ShapesRig(str(folder), neutral="rest.obj", include=["a*", "*.ply"], exclude=["a50"], corrective_names=False)
    assert rig.control_names == ("a", "a_b", "c") and len(rig.basis) == 3
    np.testing.assert_allclose(rig.basis[1].numpy(), offset(2), atol=1e-6)


def test_arkit_shapes_are_known_by_name(tmp_path):
    rig = ShapesRig(str(write_folder(tmp_path / "rig", jawOpen=POINTS + offset(0), jawOpen50=POINTS, smile=POINTS)))
    assert list(rig.arkit_deltas()) == ["jawOpen"]
    np.testing.assert_allclose(rig.arkit_deltas()["jawOpen"].numpy(), offset(0), atol=1e-6)


def test_what_was_taken_as_what_can_be_read(tmp_path):
    shapes = dict.fromkeys(["smile", "jaw", "smile50", "smile_jaw", "smile_L", "jaw_smle", "smile_jaw50"], POINTS)
    rig = ShapesRig(str(write_folder(tmp_path / "rig", **shapes)))
    said = "\n".join([rig.describe(), *rig.notes])
    for line in (
        "4 primary shapes, 1 in-between, 1 combination, 1 in-between of combinations",
        "smile50: in-between of smile at 0.5",
        "smile_jaw: combination of smile and jaw",
        "smile_jaw50: in-between of smile_jaw at 0.5",
        "jaw_smle is a shape of its own, for there is no 'smle'; if 'smile' is meant",
    ):
        assert line in said
    assert "smile_L" not in said


def test_a_folder_is_read_once_and_again_when_a_file_or_a_setting_changes(tmp_path, monkeypatch):
    read = []
    monkeypatch.setattr("rigs.shapes.build.build_geometry", lambda *given: read.append(1) or build_geometry(*given))
    folder = write_folder(tmp_path / "rig", a=POINTS + offset(0), b=POINTS)
    first = ShapesRig(str(folder))
    again = ShapesRig(str(folder))
    assert len(read) == 1 and torch.equal(first.basis, again.basis) and torch.equal(first.faces, again.faces)
    for number, settings in enumerate(({"unit_mm": 10.0}, {"exclude": ["b"]}, {"deltas": ["b"]}), start=2):
        ShapesRig(str(folder), **settings)
        assert len(read) == number
    write_obj(folder / "a.obj", POINTS + offset(1))
    np.testing.assert_allclose(ShapesRig(str(folder)).basis[0].numpy(), offset(1), atol=1e-6)
    assert len(read) == 5


def test_it_is_trained_and_evaluated_like_any_rig(run, tmp_path):
    names = ["jawOpen", "smile", "smile50", "jawOpen_smile"]
    write_folder(tmp_path / "mine", **{name: POINTS + offset(number) for number, name in enumerate(names)})
    outcome = run("train", "rig=shapes", "rig.folder=mine", "rig.unit_mm=10")
    assert outcome.code == 0, outcome.text
    assert "true rig, mine" in outcome.text and "smile50: in-between of smile" not in outcome.text
    assert "rig mine: 2 controls (2 primary shapes, 1 in-between, 1 combination)" in outcome.text
    assert "30 mm tall (30 x 30 x 10 mm)" in outcome.text and "counts as 10 mm (rig.unit_mm)" in outcome.text
    assert "smile50: in-between of smile at 0.5" in run("check", "rig=shapes", "rig.folder=mine", "verbose=true").text
    judged = run("evaluate", "bundle=run", "poses=20", folder="judged")
    assert judged.code == 0, judged.text
    assert judged.metrics["rig_poses/mean_vertex_error_mm"] == pytest.approx(outcome.metrics["rig_poses/mean_vertex_error_mm"])


def test_the_folder_of_the_page_is_what_the_page_says(tmp_path, monkeypatch, face):
    page = (ROOT / "docs/shapes.md").read_text(encoding="utf-8")
    script = re.findall(r"```python\n(.*?)```", page, re.DOTALL)[0]
    (tmp_path / "page.py").write_text(script, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    runpy.run_path("page.py")
    rig = ShapesRig("face-shapes", unit_mm=10)
    shown = re.findall(r"^    (face-shapes: .*?)\n      \.\.\.", page, re.MULTILINE | re.DOTALL)[0]
    assert rig.describe().startswith(shown.replace("\n    ", "\n"))
    np.testing.assert_allclose(rig.arkit_deltas()["mouthFunnel"].numpy(), face.arkit_deltas()["mouthFunnel"].numpy(), atol=1e-3)
    place = face.coefficient_names.index("jawLeft_mouthSmileLeft")
    found = rig.basis[rig.coefficient_names.index("jawLeft_mouthSmileLeft")]
    np.testing.assert_allclose(found.numpy(), face.basis[place].numpy(), atol=1e-3)  # the repair alone is found again


def test_the_config_says_what_the_class_takes(tmp_path):
    config = yaml.safe_load((ROOT / "conf/rig/shapes.yaml").read_text())
    assert config.pop("_target_") == "rigs.shapes.ShapesRig" and config.pop("folder") == "???"
    defaults = {name: given.default for name, given in inspect.signature(ShapesRig).parameters.items() if name != "folder"}
    assert {name: list(value) if isinstance(value, tuple) else value for name, value in defaults.items()} == config
