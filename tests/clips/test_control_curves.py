"""Curves of a rig's own controls as clips: the meshes are its poses, the truth is known, and what is written is read again."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from riginv.clips.clip import Clip
from riginv.clips.open import open_clip, open_sequence
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.errors import InputError
from tests.conftest import ROOT
from tests.support.clips import performance, write_npz
from tests.support.toys import ToyRig

TOY = ("rig=toy", f"--config-dir={ROOT / 'tests/conf'}")
PLAIN = ("look.page=false", "look.sheet=false")
FRAMES = 10


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig()


@pytest.fixture(scope="module")
def controls() -> np.ndarray:
    values = np.random.default_rng(0).uniform(0, 1, (FRAMES, 7)).round(5)
    values[:, 5] = 2 * values[:, 5] - 1
    return values


def write_csv(path: Path, names: list[str], values: np.ndarray, **more: np.ndarray) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*more, *names])
        writer.writerows([*(column[row] for column in more.values()), *values[row]] for row in range(len(values)))
    return path


def clip_of(path: Path, rig: ToyRig, **options) -> tuple[Clip, list[str]]:
    return open_clip(str(path), rig, ReadingOptions(**options), FrameOptions())


@torch.no_grad()
def posed(rig: ToyRig, controls: np.ndarray) -> torch.Tensor:
    return rig(torch.tensor(controls, dtype=torch.float32))


@pytest.mark.parametrize("kind", ["csv", "seconds.csv", "plain.csv", "npz", "half.npz", "nameless.npz"])
def test_curves_are_the_poses_of_the_rig_and_the_truth_is_known(kind, rig, controls, tmp_path):
    path, names = tmp_path / f"take.{kind}", list(rig.control_names)
    numbers = np.arange(FRAMES) * 2 + 100
    order = np.random.default_rng(1).permutation(7)
    shuffled = [names[number] for number in order]
    if kind == "csv":
        write_csv(path, shuffled, controls[:, order], frame=numbers, seconds=(numbers - 100) / 48)
    elif kind == "seconds.csv":
        write_csv(path, names, controls, seconds=np.arange(FRAMES) / 25)
    elif kind == "plain.csv":
        write_csv(path, names, controls)
    elif kind == "nameless.npz":
        np.savez(path, controls=controls)
    else:
        values = controls[:, order].astype(np.float16 if kind == "half.npz" else np.float64)
        np.savez(path, controls=values, names=np.array(shuffled), fps=48.0, frame_numbers=numbers)
    clip, notes = clip_of(path, rig)
    near = 1e-3 if kind == "half.npz" else 1e-6
    assert np.abs(clip.controls.numpy() - controls).max() < near
    assert (clip.vertices(0, FRAMES) - posed(rig, controls)).norm(dim=2).max() < (0.05 if kind == "half.npz" else 1e-4)
    assert clip.fps == {"csv": 48, "seconds.csv": 25, "npz": 48, "half.npz": 48}.get(kind, 30)
    assert clip.frame_numbers.tolist() == (numbers.tolist() if kind in ("csv", "npz", "half.npz") else list(range(FRAMES)))
    assert clip.sequence.in_rig_space and any("the rig's order" in note for note in notes) == (kind == "nameless.npz")
    part = open_clip(str(path), rig, ReadingOptions(), FrameOptions(first=int(clip.frame_numbers[3])))[0]
    assert torch.equal(part.controls, clip.controls[3:])


def test_names_that_do_not_fit(rig, controls, tmp_path):
    names = list(rig.control_names)
    fewer = write_csv(tmp_path / "fewer.csv", names[:-2], controls[:, :-2])
    with pytest.raises(InputError, match="does not name 2 of the 7 controls.*side, all.*ignore_missing"):
        clip_of(fewer, rig)
    clip, notes = clip_of(fewer, rig, unknown="ignore_missing")
    assert (clip.controls[:, -2:] == 0).all() and any("stay at neutral: side, all" in note for note in notes)
    more = write_csv(tmp_path / "more.csv", [*names, "extra", "still"], np.c_[controls, controls[:, 0], np.ones(FRAMES)])
    with pytest.raises(InputError, match="'extra' moves, and rig 'toy' has no such control; reading.unknown=ignore_new"):
        clip_of(more, rig)
    assert "left out: extra, still" in clip_of(more, rig, unknown="ignore_new")[1][0]
    resting = write_csv(
        tmp_path / "rest.csv", [*names, "still", "comment"], np.c_[controls, np.ones(FRAMES), np.full(FRAMES, "x")]
    )
    assert "left out: still, comment" in clip_of(resting, rig)[1][0]
    with pytest.raises(InputError, match=r"none of its columns \(a, b\) is a control of rig 'toy'.*timecodes"):
        clip_of(write_csv(tmp_path / "other.csv", ["a", "b"], controls[:, :2]), rig)


def test_values_beyond_their_limits_are_said_and_brought_back(rig, controls, tmp_path):
    beyond = controls.copy()
    beyond[4, 0], beyond[5, 5], beyond[6, 1] = 1.25, -1.5, 1 + 1e-7
    clip, notes = clip_of(write_csv(tmp_path / "take.csv", list(rig.control_names), beyond), rig)
    assert float(clip.controls[4, 0]) == 1 and float(clip.controls[5, 5]) == -1
    assert "2 values lie beyond" in notes[0] and "'bump0' at 1.25 in frame 4 (0 to 1)" in notes[0]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"controls": np.full((FRAMES, 7), np.nan)}, "is nan in row 0"),
        ({"controls": np.zeros((FRAMES, 7, 2))}, "expected numbers \\(frame, control\\)"),
        ({"controls": np.zeros((FRAMES, 5)), "names": np.array([])}, "names are"),
        ({"controls": np.zeros((FRAMES, 5)), "names": None}, "curves of 5 controls without names, and rig 'toy' has 7"),
        ({"controls": np.zeros((0, 7))}, "no frames"),
        ({"fps": np.array([1.0, 2.0])}, "fps is"),
        ({"frame_numbers": np.zeros(FRAMES, int)}, "do not rise"),
        ({"names": np.array(["bump0"] * 7)}, "'bump0' is there twice"),
        ({"names": np.array([object()] * 7)}, "names"),
    ],
)
def test_arrays_that_are_no_curves_are_refused(change, says, rig, controls, tmp_path):
    arrays = {"controls": controls, "names": np.array(rig.control_names)} | change
    np.savez(tmp_path / "take.npz", **{name: values for name, values in arrays.items() if values is not None})
    with pytest.raises(InputError, match=f"take.npz.*{says}"):
        clip_of(tmp_path / "take.npz", rig)


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("frame", "frame", ""),
        ("\n3,", "\n2,", "do not rise"),
        ("\n3,", "\n3.5,", "no whole numbers"),
        ("\n3,", "\nx,", "line 5, column frame"),
    ],
)
def test_frames_of_a_csv_rise_and_are_whole(before, after, says, rig, controls, tmp_path):
    path = write_csv(tmp_path / "take.csv", list(rig.control_names), controls, frame=np.arange(FRAMES))
    path.write_text(path.read_text().replace("\r", "").replace(before, after, 1))
    if says:
        with pytest.raises(InputError, match=f"take.csv.*{says}"):
            clip_of(path, rig)
    else:
        assert len(clip_of(path, rig)[0]) == FRAMES


def test_a_file_beside_the_curves_that_contradicts_them_is_said(rig, controls, tmp_path):
    path = write_csv(
        tmp_path / "take.csv", list(rig.control_names), controls, frame=np.arange(FRAMES), seconds=np.arange(FRAMES) / 25
    )
    for content, said in (
        ('{"fps": 25.0}', ""),
        ('{"fps": 60}', "60 frames a second, its rows have 25"),
        ("[", "ignored"),
    ):
        (tmp_path / "take.json").write_text(content)
        clip, notes = clip_of(path, rig)
        assert clip.fps == 25 and any(said in note for note in notes) == bool(said), notes


@pytest.mark.parametrize("moved", [False, True])
def test_what_invert_writes_is_read_again(moved, run, rig, tmp_path):
    meshes = performance(rig, 20)
    if moved:
        angle = np.linspace(0, 1.2, 20)
        turn = np.stack([np.cos(angle), 0 * angle, np.sin(angle), 0 * angle, 1 + 0 * angle, 0 * angle], axis=1).reshape(
            20, 2, 3
        )
        turn = np.concatenate([turn, np.cross(turn[:, :1], turn[:, 1:])], axis=1)
        meshes = meshes @ turn.transpose(0, 2, 1) + 300 * np.stack([angle, 0 * angle, angle], axis=1)[:, None]
    clip = write_npz(tmp_path / "take.npz", meshes, rig.faces.numpy())
    first = run("invert", *TOY, *PLAIN, f"clip={clip}", "out=a", "method=levenberg_marquardt")
    assert first.code == 0, first.text
    sequence = open_sequence(str(tmp_path / "a/curves.csv"), rig, ReadingOptions())
    assert sequence.fps == 24 and sequence.facts.rate_source == "curves.json" and sequence.in_rig_space != moved
    assert np.linalg.norm(sequence.read(0, 20) - meshes, axis=2).mean() < 0.1
    again = run("invert", *TOY, *PLAIN, "clip=a/curves.csv", "out=b", "method=levenberg_marquardt")
    assert again.code == 0, again.text
    tables = [np.genfromtxt(tmp_path / folder / "curves.csv", delimiter=",", names=True) for folder in "ab"]
    assert tables[0].dtype.names == tables[1].dtype.names
    for name in rig.control_names:
        np.testing.assert_allclose(tables[1][name], tables[0][name], atol=0.02)
    errors = json.loads((tmp_path / "b/curves.json").read_text())["errors"]
    assert errors["mean_error_mm"] < 0.05 < errors["neutral_mean_error_mm"]


def test_curves_written_as_a_recording_are_read_again(run, tmp_path):
    """Live Link Face out, and in: a rig whose controls are ARKit's gets the same controls."""
    from tests.clips.test_takes import rig_of
    from tests.support.takes import curves, timecode, write_take

    names = ("browInnerUp", "jawOpen", "mouthSmileLeft")
    rig_of(tmp_path, *names)
    weights = curves(names, 24)
    take = write_take(tmp_path / "take.csv", weights, [timecode(frame, 25, 60) for frame in (*range(12), *range(50, 62))])
    shapes = ("rig=shapes", f"rig.folder={tmp_path / 'rig'}", *PLAIN, "method=levenberg_marquardt")
    first = run("invert", *shapes, f"clip={take}", "out=a", "formats=[csv,livelink]")
    assert first.code == 0, first.text
    again = run("invert", *shapes, "clip=a/live_link.csv", "out=b", "formats=[csv,livelink]")
    assert again.code == 0, again.text
    for folder in "ab":
        table = np.genfromtxt(tmp_path / folder / "curves.csv", delimiter=",", names=True)
        assert table["frame"].tolist() == [*range(12), *range(50, 62)]
        for name in names:
            np.testing.assert_allclose(table[name], weights[name], atol=1e-3)
    assert json.loads((tmp_path / "b/curves.json").read_text())["fps"] == pytest.approx(25)


def test_a_clip_of_curves_judges(run, rig, controls, tmp_path):
    path = write_csv(
        tmp_path / "take.csv", list(rig.control_names), controls, frame=np.arange(FRAMES), seconds=np.arange(FRAMES) / 25
    )
    outcome = run("compare", *TOY, f"capture={path}", "methods=[neutral,levenberg_marquardt]", "poses=4")
    assert outcome.code == 0, outcome.text
    table = csv.DictReader((outcome.folder / "compare.csv").read_text().splitlines())
    rows = {(row["method"], row["set"]): row for row in table}
    assert float(rows["levenberg_marquardt", "capture"]["mean_vertex_error_mm"]) < 0.2
    neutral = float(rows["neutral", "capture"]["mean_vertex_error_mm"])
    assert neutral == pytest.approx(float((posed(rig, controls) - rig.rest_vertices).norm(dim=2).mean()), rel=1e-4)
