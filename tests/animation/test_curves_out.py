"""Tables, Live Link Face and Maya curves, read back by readers that are not ours; what is refused."""

import csv
import json
import re
import sys

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from riginv.animation.animation import Animation
from riginv.animation.formats import FORMATS, check_formats, write_formats
from riginv.animation.live_link import nearest_weights, timecode
from riginv.clips.live_link import read_live_link
from riginv.errors import InputError
from riginv.rig.arkit import LIVE_LINK_SHAPES
from riginv.rig.interface import Control
from tests.support.animations import NUMBERS, errors_of, moving
from tests.support.toys import BlackBox, ToyRig


def test_tables(toy_written):
    folder, animation = toy_written
    rows = list(csv.reader((folder / "curves.csv").read_text().splitlines()))
    assert rows[0][:4] == ["frame", "seconds", "bump0", "bump1"]
    assert [int(row[0]) for row in rows[1:]] == NUMBERS.tolist()
    table = np.array([[float(value) for value in row] for row in rows[1:]])
    np.testing.assert_allclose(table[:, 2:9], animation.controls.numpy(), rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(table[:, 1], (NUMBERS.numpy() - 101) / 25, atol=1e-6)
    motion = Rotation.from_euler("xyz", table[:, 12:], degrees=True).as_matrix()
    np.testing.assert_allclose(motion, animation.motion[:, :3, :3].numpy(), atol=1e-6)
    np.testing.assert_allclose(table[:, 9:12], animation.motion[:, :3, 3].numpy(), atol=1e-4)
    assert np.abs(np.diff(table[:, 12:], axis=0)).max() < 90  # no jumps by 360 degrees
    facts = json.loads((folder / "curves.json").read_text())
    assert facts["fps"] == 25.0 and facts["made_by"]["bundle"] == "0123abcd"
    assert facts["controls"][5] == {"name": "side", "lower": -1.0, "upper": 1.0, "neutral": 0.0, "unit": ""}
    frames = list(csv.DictReader((folder / "frames.csv").read_text().splitlines()))
    assert frames[3]["flags"] == "outside_reach;not_converged" and frames[1]["worst_region"] == "mouth"
    assert float(frames[-1]["max_error_mm"]) == pytest.approx(1.2)


def test_errors_may_be_found_while_curves_are_written(tmp_path, face):
    animation = moving(face, numbers=torch.arange(5))
    errors = errors_of(animation)
    for name, given in (("given", errors), ("found", lambda: errors)):
        (tmp_path / name).mkdir()
        paths = write_formats(tmp_path / name, animation, given, ["livelink", "anim"])
        assert [path.name for path in paths] == ["curves.csv", "curves.json", "frames.csv", "live_link.csv", "curves.anim"]
    for path in (tmp_path / "given").iterdir():
        assert path.read_bytes() == (tmp_path / "found" / path.name).read_bytes()


def test_live_link(tmp_path, face):
    animation = moving(face, numbers=torch.arange(30, 42))
    write_formats(tmp_path / "a", animation, errors_of(animation), ["livelink"])
    write_formats(tmp_path / "b", animation, errors_of(animation), ["livelink"], swap_mouth=True)
    plain, swapped = (list(csv.DictReader((tmp_path / name / "live_link.csv").read_text().splitlines())) for name in "ab")
    assert plain[0]["Timecode"] == "00:00:01:12.000" and plain[0]["BlendShapeCount"] == "61"
    assert len(plain[0]) == 63 and len(plain) == 12
    assert [row["MouthLeft"] for row in plain] == [row["MouthRight"] for row in swapped]
    yaw = Rotation.from_matrix(animation.motion[:, :3, :3].numpy()).as_euler("YXZ")[:, 0]
    np.testing.assert_allclose([float(row["HeadYaw"]) for row in plain], yaw, atol=1e-6)
    again = read_live_link(tmp_path / "a" / "live_link.csv")
    assert again.fps == pytest.approx(25.0) and again.weights.min() >= 0 and again.weights.max() <= 1


def test_live_link_has_the_columns_of_the_app(tmp_path, face, capture_file):
    animation = moving(face, numbers=torch.arange(2))
    write_formats(tmp_path, animation, errors_of(animation), ["livelink"])
    assert (tmp_path / "live_link.csv").read_text().splitlines()[0] == capture_file.read_text("utf-8-sig").splitlines()[0]


def test_live_link_weights_are_the_nearest(face):
    """Against SciPy's bounded least squares."""
    from scipy.optimize import lsq_linear

    names, deltas = list(face.arkit_deltas()), torch.stack(list(face.arkit_deltas().values()))
    controls = moving(face).controls[:2]
    found = nearest_weights(face, deltas, controls)
    for weights, mesh in zip(found, face(controls)):
        aim = (mesh - face.rest_vertices).flatten().double().numpy()
        best = lsq_linear(deltas.flatten(1).T.double().numpy(), aim, bounds=(0, 1))
        mine = np.square(deltas.flatten(1).T.double().numpy() @ weights.numpy() - aim).sum() / 2
        assert mine <= best.cost * 1.001
    assert len(names) == 52


def test_live_link_of_a_rig_with_arkit_controls():
    class Arkit(ToyRig):
        def __init__(self):
            super().__init__()
            self.controls = (Control("face.JawOpen"), Control("mouth_smile_L"), *self.controls[2:])

    from riginv.animation.live_link import arkit_weights

    animation = moving(Arkit())
    weights = arkit_weights(animation)
    assert torch.equal(weights[:, LIVE_LINK_SHAPES.index("JawOpen")].float(), animation.controls[:, 0])
    assert torch.equal(weights[:, LIVE_LINK_SHAPES.index("MouthSmileLeft")].float(), animation.controls[:, 1])


def test_timecodes_carry_over():
    assert timecode(3661.0) == "01:01:01:00.000"
    assert timecode(0.9999999) == "00:00:01:00.000"
    assert timecode(86400 + 0.25) == "00:00:00:15.000"


def test_maya_anim(toy_written):
    """No free software reads .anim: what the manual's grammar says is written out here once more."""
    folder, animation = toy_written
    key = r"\s+(\S+) (\S+) linear linear 1 1 0;\n"
    curve = (
        r"anim (\S+) (\S+) (\S+) 0 0 (\d+);\nanimData \{\n  input time;\n  output (unitless|angular|linear);\n  weighted 0;\n"
        r"  preInfinity constant;\n  postInfinity constant;\n  keys \{\n((?:" + key.replace("(", "(?:") + r")+)  \}\n\}\n"
    )
    text = (folder / "curves.anim").read_text()
    head, count = re.match(r"((?:\w+ \S+;\n)+)", text)[1], 0
    assert "animVersion 1.1;" in head and "timeUnit pal;" in head and "angularUnit deg;" in head
    rest = text[len(head) :]
    assert re.fullmatch(f"(?:{curve})+", rest)
    for number, found in enumerate(re.finditer(curve, rest)):
        keys = np.array(re.findall(key, found[6]), float)
        assert int(found[4]) == (number if number < 7 else number - 7)
        if number < 7:
            assert found[1] == animation.rig.control_names[number] and found[3] == "toy_controls"
            assert keys[:, 0].tolist() == NUMBERS.tolist()
            np.testing.assert_allclose(keys[:, 1], animation.controls[:, number].numpy(), rtol=1e-6, atol=1e-7)
        else:
            assert found[3] == "toy_motion"
        count += 1
    assert count == 7 + 6


def test_maya_takes_any_frame_rate(tmp_path):
    animation = moving(ToyRig(), fps=23.976)
    write_formats(tmp_path, animation, errors_of(animation), ["anim"])
    text = (tmp_path / "curves.anim").read_text()
    assert "timeUnit sec;" in text and f"    {102 / 23.976:.9g} " in text


def test_what_a_rig_cannot_give_is_refused_before_anything_is_written(tmp_path, face):
    animation = moving(BlackBox())
    for name, words in (("glb", "neither"), ("usd", "neither"), ("bvh", "has none"), ("livelink", "ARKit")):
        with pytest.raises(InputError, match=words):
            write_formats(tmp_path, animation, errors_of(animation), ["csv", name])
    with pytest.raises(InputError, match="'fbx' is not known; choose from csv, livelink"):
        check_formats(face, ["fbx"])
    with pytest.raises(InputError, match="formats: bvh holds joints, and rig 'face' has none that make a skeleton of one root"):
        check_formats(face, [name for name in FORMATS if name != "usd"])  # which takes a package of its own
    assert not list(tmp_path.iterdir())


def test_names_that_maya_cannot_tell_apart_are_refused():
    rig = ToyRig(last_name="bump.0")
    check_formats(rig, ["anim"])
    rig.controls = (Control("a.b"), Control("a_b"), *rig.controls[2:])
    with pytest.raises(InputError, match=r"'a\.b' and 'a_b' are both 'a_b'"):
        check_formats(rig, ["anim"])


def test_what_makes_no_animation_is_refused():
    rig = ToyRig()
    good = {"rig": rig, "controls": torch.zeros(3, 7), "fps": 30.0, "frame_numbers": torch.arange(3)}
    for change, words in (
        ({"controls": torch.zeros(3, 6)}, r"need \(3, 7\)"),
        ({"controls": torch.full((3, 7), torch.nan)}, "frame 0: control 'bump0' is not a finite number"),
        ({"fps": 0.0}, "fps is 0.0, expected a number above 0"),
        ({"fps": float("nan")}, "fps is nan"),
        ({"frame_numbers": torch.tensor([0, 0, 1])}, "do not rise"),
        ({"frame_numbers": torch.arange(0), "controls": torch.zeros(0, 7)}, "no frames"),
        ({"motion": torch.eye(4)}, r"expected \(3, 4, 4\)"),
    ):
        with pytest.raises(InputError, match=words):
            Animation(**(good | change))


def test_usd_without_its_package_is_a_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(InputError, match=r"pip install 'riginv\[usd\]'"):
        check_formats(ToyRig(), ["usd"])
