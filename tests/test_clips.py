"""Recordings and simulated performances as mesh clips."""

from pathlib import Path

import pytest
import torch

from riginv.clips.live_link import live_link_clip, read_live_link
from riginv.clips.performance import simulated_performance
from riginv.errors import InputError
from rigs.face.shapes import ARKIT_NAMES
from tests.toys import BlackBox, ToyRig

HEADER = ["Timecode", "BlendShapeCount", *(name[0].upper() + name[1:] for name in ARKIT_NAMES), "HeadYaw", "LeftEyeRoll"]


def write(path: Path, rows: list[list], header: list[str] = HEADER) -> Path:
    path.write_text("\n".join(",".join(str(value) for value in row) for row in [header, *rows]) + "\n")
    return path


def row(frame: int, value: float | str = 0.25) -> list:
    return [f"10:00:00:{frame:02d}.000", 61, *[value] * 52, 0, 0]


def test_a_recording_is_read_with_its_names_and_rate(tmp_path):
    recording = read_live_link(write(tmp_path / "take.csv", [row(0), row(2), row(4, 0.5)]))
    assert recording.names == list(ARKIT_NAMES) and recording.fps == pytest.approx(30)
    assert recording.weights[:, 0].tolist() == [0.25, 0.25, 0.5]


def test_the_clip_adds_the_shapes_linearly(tmp_path, face):
    clip = live_link_clip(write(tmp_path / "take.csv", [row(0), row(2, 0.5)]), face)
    shapes = torch.stack(list(face.arkit_deltas().values()))
    assert len(clip) == 2 and clip.name == "capture"
    torch.testing.assert_close(clip.vertices(1, 2)[0], face.rest_vertices + 0.5 * shapes.sum(dim=0), atol=1e-3, rtol=0)


def test_columns_may_stand_in_any_order(tmp_path, face):
    order = [0, 1, *reversed(range(2, 54)), 54, 55]
    values = ["10:00:00:00.0", 61, *[0.0] * 52, 0, 0]
    values[HEADER.index("JawOpen")] = 1.0
    path = write(tmp_path / "take.csv", [[values[i] for i in order]], [HEADER[i] for i in order])
    moved = live_link_clip(path, face).vertices(0, 1)[0] - face.rest_vertices
    torch.testing.assert_close(moved, face.arkit_deltas()["jawOpen"], atol=1e-4, rtol=0)


def test_the_real_clip_is_read(capture_file, face):
    clip = live_link_clip(capture_file, face)
    assert len(clip) == 4030 and clip.fps == pytest.approx(30, abs=0.1)
    moved = torch.cat([clip.vertices(start, start + 10) - face.rest_vertices for start in range(0, 4030, 400)]).norm(dim=2)
    assert 1 < moved.mean() < 3 and moved.max() < 40


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda path: path / "none.csv", "no such file"),
        (lambda path: write(path / "a.csv", []), "no frames"),
        (lambda path: write(path / "a.csv", [row(0, "nan")]), "line 2, column BrowDownLeft.*'nan'"),
        (lambda path: write(path / "a.csv", [row(0), row(2, "inf")]), "line 3.*finite"),
        (lambda path: write(path / "a.csv", [row(0, "high")]), "'high'"),
        (lambda path: write(path / "a.csv", [row(0)[:-1]]), "line 2: 55 values, expected 56"),
        (lambda path: write(path / "a.csv", [row(0)[:20] + row(0)[21:]], HEADER[:20] + HEADER[21:]), "1 of the 52.*missing"),
        (lambda path: write(path / "a.csv", [row(0)], [*HEADER[:-1], "JawOpen"]), "'JawOpen' stands twice"),
        (lambda path: write(path / "a.csv", [row(0)], ["Time", *HEADER[1:]]), "Timecode first"),
        (lambda path: write(path / "a.csv", [["soon", *row(0)[1:]]]), "expected HH:MM:SS"),
        (lambda path: write(path / "a.csv", [row(0)], [*HEADER[:-1], "EarWiggle"]), None),
        (lambda path: write(path / "a.csv", [[*row(0)[:-1], 0.5]], [*HEADER[:-1], "EarWiggle"]), "EarWiggle.*moves"),
    ],
)
def test_bad_recordings_are_refused_in_one_sentence(tmp_path, face, make, says):
    if says is None:
        assert len(live_link_clip(make(tmp_path), face)) == 1  # an unknown shape that never moves does no harm
        return
    with pytest.raises(InputError, match=says):
        live_link_clip(make(tmp_path), face)


def test_an_empty_or_binary_file_is_refused(tmp_path, face):
    for content, says in ((b"", "empty"), (b"\xff\xfe\x00binary", "cannot be read|expected the columns")):
        path = tmp_path / "bad.csv"
        path.write_bytes(content)
        with pytest.raises(InputError, match=says):
            live_link_clip(path, face)


def test_a_rig_without_arkit_shapes_says_so(tmp_path):
    with pytest.raises(InputError, match="no ARKit shapes"):
        live_link_clip(write(tmp_path / "take.csv", [row(0)]), ToyRig())


def test_a_simulated_performance_is_smooth_and_the_same_every_time(face):
    clip = simulated_performance(face, frames=300)
    assert clip.name == "simulated_performance" and len(clip) == 300 and clip.fps == 30
    assert torch.equal(clip.weights, simulated_performance(face, frames=300).weights)
    assert 0 <= clip.weights.min() and 0.5 < clip.weights.max() <= 1
    assert (clip.weights[1:] - clip.weights[:-1]).abs().max() < 0.25
    assert len(simulated_performance(ToyRig(), frames=10)) == 10


def test_a_performance_needs_frames_and_shapes(face):
    with pytest.raises(InputError, match="expected at least 1"):
        simulated_performance(face, frames=0)
    assert simulated_performance(BlackBox()) is None
