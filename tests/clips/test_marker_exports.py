"""Markers as capture software exports them: CSV of Motive and of Vicon, TRC of other programs and countries."""

import numpy as np
import pytest

from riginv.clips.markers import MarkerClip, open_markers
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import SourceFacts
from riginv.clips.times import frames_from_times
from riginv.errors import InputError
from riginv.tracking.markers.map_file import matched
from tests.support.markers import placed, write_motive, write_trc, write_vicon
from tests.support.toys import ToyRig

NAMES = ["nose", "chin", "brow L"]
POINTS = np.random.default_rng(0).uniform(-100, 100, (6, 3, 3)).round(4)
POINTS[2:4, 1] = np.nan


@pytest.mark.parametrize(
    ("write", "unit", "fps", "unit_mm"),
    [(write_motive, "Millimeters", 120, 1.0), (write_motive, "Meters", 120, 1000.0), (write_vicon, "cm", 100, 10.0)],
)
def test_exports_of_capture_software_are_read(tmp_path, write, unit, fps, unit_mm):
    clip = open_markers(str(write(tmp_path / "take.csv", NAMES, POINTS, fps, unit)))
    assert list(clip.names) == [f"Face:{name}" for name in NAMES]
    np.testing.assert_allclose(clip.points, POINTS, atol=1e-4)
    assert (clip.fps, clip.unit_mm, clip.frame_numbers.tolist()) == (fps, unit_mm, list(range(7, 13)))


@pytest.mark.parametrize(
    ("write", "before", "after", "said"),
    [
        (write_motive, "Frame,Time (Seconds)", "Sample,Time", "without its row of axes"),
        (write_motive, ",Marker", ",Bone", "no markers"),
        (write_motive, f"{POINTS[1, 0, 0]:.4f}", "lost", "line 9: found 'lost'"),
        (write_vicon, "Face:chin", "Face:nose", "'Face:nose' is there twice"),
        (write_vicon, "\n9,0", "\n8,0", "do not rise"),
        (write_vicon, "Sub Frame,X", "X", "no markers"),
    ],
)
def test_damaged_exports_end_in_a_sentence(tmp_path, write, before, after, said):
    path = write(tmp_path / "take.csv", NAMES, POINTS)
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))
    with pytest.raises(InputError, match=said):
        open_markers(str(path))


def test_a_take_may_have_a_name_in_another_encoding(tmp_path):
    path = write_motive(tmp_path / "take.csv", NAMES, POINTS)
    path.write_bytes(path.read_text().replace("A take", "Köpfe").encode("latin-1"))
    np.testing.assert_allclose(open_markers(str(path)).points, POINTS, atol=1e-4)


def test_titles_of_columns_have_several_forms(tmp_path):
    for form in ("{}.x", "{}_TX", "{}:x", "{} X", "{} (X)", "{}[x]"):
        titles = [form.format(name).replace("x", axis).replace("X", axis) for name in NAMES for axis in "xyz"]
        lines = [",".join(titles), *(",".join(map(str, frame.reshape(-1))) for frame in POINTS)]
        (tmp_path / "take.csv").write_text("\n".join(lines) + "\n")
        assert list(open_markers(str(tmp_path / "take.csv")).names) == NAMES, form


def test_a_trc_file_may_have_decimal_commas_and_another_encoding(tmp_path):
    path = write_trc(tmp_path / "take.trc", NAMES, POINTS)
    text = path.read_text().replace(".", ",").replace("PathFileType\t4", "PathFileType\tMüller")
    path.write_bytes(text.encode("latin-1"))
    np.testing.assert_allclose(open_markers(str(path)).points, POINTS, atol=1e-4)


def test_a_trc_file_without_a_rate_has_that_of_its_times_and_a_contradiction_is_noted(tmp_path):
    path = write_trc(tmp_path / "take.trc", NAMES, POINTS, fps=30.0)
    whole = path.read_text()
    path.write_text(whole.replace("30.00", "0"))
    clip = open_markers(str(path))
    assert (clip.fps, clip.facts.rate_source) == (30, "its times")
    path.write_text(whole.replace("30.00", "120"))
    clip = open_markers(str(path))
    assert clip.fps == 120 and "its times give 30" in " ".join(clip.facts.notes)


def test_a_trc_file_that_ends_within_a_line_is_read_without_it(tmp_path):
    path = write_trc(tmp_path / "take.trc", NAMES, POINTS)
    path.write_text(path.read_text()[:-30])
    clip = open_markers(str(path))
    assert len(clip.points) == len(POINTS) - 1 and "cut short" in clip.facts.notes[0]


@pytest.mark.parametrize(("fps", "frames"), [(30, 12), (24, 12), (60, 40), (29.97, 200), (23.976, 200), (100, 20)])
def test_times_that_a_text_has_rounded_give_the_rate(fps, frames):
    found = frames_from_times(np.round(np.arange(frames) / fps, 3), "times")
    assert found.fps == pytest.approx(fps, rel=1e-5) and not found.notes


def test_prefixes_of_the_markers_of_a_map_are_ignored_beside_others():
    placement = placed(ToyRig(), 6)
    names = (*(f"actor:{name}" for name in placement.names), "sword:tip")
    clip = MarkerClip("take", names, np.ones((2, 7, 3), np.float32), np.arange(2), SourceFacts("markers"))
    found = matched(clip, placement, "map", ReadingOptions(unknown="ignore_new"))[0]
    assert found.names == tuple(placement.names)
    twice = MarkerClip("take", (*names[:6], "other:m00"), clip.points, np.arange(2), clip.facts)
    with pytest.raises(InputError, match="'actor:m00', 'other:m00' are not in the map"):
        matched(twice, placement, "map", ReadingOptions())
