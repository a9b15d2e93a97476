"""Takes of markers in C3D, TRC and CSV files."""

import numpy as np
import pytest

from riginv.clips.markers import open_markers
from riginv.errors import InputError
from tests.support.markers import write_c3d, write_csv, write_trc

NAMES = ["nose", "chin", "brow L", "brow R"]
WRITERS = {".c3d": write_c3d, ".trc": write_trc, ".csv": write_csv}


@pytest.fixture
def points() -> np.ndarray:
    points = np.random.default_rng(0).uniform(-100, 100, (12, 4, 3))
    points[3:5, 1] = np.nan
    return points


@pytest.mark.parametrize("suffix", WRITERS)
def test_what_was_written_is_read(tmp_path, points, suffix):
    clip = open_markers(str(WRITERS[suffix](tmp_path / f"take{suffix}", NAMES, points)))
    assert list(clip.names) == NAMES and clip.fps == pytest.approx(30)
    assert np.nanmax(np.abs(clip.points - points)) < 1e-3
    assert np.array_equal(np.isnan(clip.points).all(axis=2), np.isnan(points).all(axis=2))
    assert clip.unit_mm == (None if suffix == ".csv" else 1.0)


def test_c3d_agrees_with_the_library_that_wrote_it(tmp_path, points):
    import ezc3d

    path = write_c3d(tmp_path / "take.c3d", NAMES, points, 120.0, "m")
    theirs = ezc3d.c3d(str(path))["data"]["points"][:3].transpose(2, 1, 0)
    ours = open_markers(str(path))
    assert np.array_equal(ours.points, theirs.astype(np.float32), equal_nan=True)
    assert (ours.fps, ours.unit_mm) == (120.0, 1000.0)


def test_integers_of_a_c3d_file_are_scaled(tmp_path, points):
    path = write_c3d(tmp_path / "take.c3d", NAMES, np.nan_to_num(points, nan=1.0))
    data = bytearray(path.read_bytes())
    start = 512 * (int.from_bytes(data[16:18], "little") - 1)
    values = np.frombuffer(bytes(data[start : start + 12 * 4 * 16]), "<f4").reshape(12, 4, 4).copy()
    values[..., :3] /= 0.01
    data[12:16] = np.float32(0.01).tobytes()
    path.write_bytes(bytes(data[:start]) + values.round().astype("<i2").tobytes())
    assert np.abs(open_markers(str(path)).points - np.nan_to_num(points, nan=1.0)).max() < 0.006


def test_trajectories_without_a_name_are_left_out(tmp_path, points):
    clip = open_markers(str(write_c3d(tmp_path / "take.c3d", ["nose", "*1", "chin", "*2"], points)))
    assert clip.names == ("nose", "chin")
    assert "2 of 4 points have no name" in clip.facts.notes[0]


def test_points_at_the_origin_are_gaps(tmp_path, points):
    points[7, 2] = 0
    clip = open_markers(str(write_trc(tmp_path / "take.trc", NAMES, points)))
    assert np.isnan(clip.points[7, 2]).all() and "gaps" in clip.facts.notes[0]


def test_a_c3d_file_that_is_cut_short_is_read_as_far_as_it_goes(tmp_path, points):
    path = write_c3d(tmp_path / "take.c3d", NAMES, np.tile(points, (40, 1, 1)))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) - 64 * 100])
    clip = open_markers(str(path))
    assert 300 < len(clip.points) < 480 and "cut short" in " ".join(clip.facts.notes)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.c3d", b"", "no C3D file"),
        ("a.c3d", b"\2\120" + bytes(1022), "processor type 0"),
        ("a.trc", b"hello\n", "PathFileType"),
        ("a.trc", b"PathFileType\t4\nDataRate\n30\nFrame#\tTime\tnose\tchin\n\n1\t0\t1\t2\t3\n", "three columns apart"),
        ("a.trc", b"PathFileType\t4\nDataRate\n30\nFrame#\tTime\tnose\n\n1\t0\t1\tx\t3\n", "line 6: found 'x'"),
        ("a.trc", b"PathFileType\t4\nDataRate\n30\nFrame#\tTime\tnose\n\n", "no frames"),
        ("a.trc", b"PathFileType\t4\nDataRate\n30\nFrame#\tTime\tnose\n\n1\t0\t1\t2\t3\t4\n", "6 fields, expected 5"),
        ("a.csv", b"frame,nose.x,nose.y\n0,1,2\n", "columns for x, y, expected x, y and z"),
        ("a.csv", b"frame,nose.x,nose.y,nose.z\n0,1,2,up\n", "found 'up'"),
        ("a.csv", b"frame,jaw\n0,1\n", "no markers"),
        ("a.csv", b"frame,nose.x,nose.y,nose.z\n3,1,2,3\n2,1,2,3\n", "do not rise"),
        ("a.bvh", b"", "end in .c3d"),
    ],
)
def test_what_cannot_be_read_is_told_in_a_sentence(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said) as error:
        open_markers(str(tmp_path / name))
    assert "\n" not in str(error.value)


def test_numbers_that_stand_for_nothing_are_gaps_and_said(tmp_path):
    rows = "1,0,-9999,-9999,-9999\n2,0.1,1,2,-9999\n3,0.2,9999,-9999,9999\n"
    (tmp_path / "a.csv").write_text("Frame,Time (s),nose_X,nose_Y,nose_Z\n" + rows)
    clip = open_markers(str(tmp_path / "a.csv"))
    assert np.isnan(clip.points[0]).all() and np.isfinite(clip.points[1:]).all() and clip.fps == 10
    assert "Taken as gaps: 1 marker at -9999 on all axes." in clip.facts.notes


def test_words_for_nothing_are_gaps_and_said(tmp_path):
    rows = "0,1,2,3,-,-,-\n1,1,2,3,#N/A,NULL,n/a\n2,1,2,3,--,None,\n3,1,2,3,4,5,6\n"
    (tmp_path / "a.csv").write_text("frame,nose.x,nose.y,nose.z,chin.x,chin.y,chin.z\n" + rows)
    clip = open_markers(str(tmp_path / "a.csv"))
    assert np.isnan(clip.points[:3, 1]).all() and clip.points[3, 1].tolist() == [4, 5, 6]
    assert clip.facts.notes == ("Taken as gaps: 8 cells of '-', '#N/A', 'NULL', 'n/a', '--', 'None'.",)
    head = "PathFileType\t4\nDataRate\tUnits\n30\tmm\nFrame#\tTime\tnose\t\t\n\n"
    (tmp_path / "a.trc").write_text(head + "1\t0\t-\t-\t-\n2\t0.1\t1\t2\t3\n")
    clip = open_markers(str(tmp_path / "a.trc"))
    assert np.isnan(clip.points[0]).all() and "Taken as gaps: 3 cells of '-'." in clip.facts.notes
    (tmp_path / "b.csv").write_text("frame,nose.x,nose.y,nose.z\n0,1,2,3\n-,1,2,3\n")
    with pytest.raises(InputError, match="a gap in column 'frame'"):
        open_markers(str(tmp_path / "b.csv"))
    (tmp_path / "c.csv").write_text("frame,nose.x,nose.y,nose.z\n0,-,2,3\n1,up,2,3\n")
    with pytest.raises(InputError, match="line 3, column nose.x: found 'up'"):
        open_markers(str(tmp_path / "c.csv"))


def test_timestamps_are_times_or_dates(tmp_path):
    for stamps, fps in (((0.0, 0.1), 10), ((1700000000000, 1700000000100), 10), (("2024-01-01T10:00:00", "10:00"), None)):
        rows = "".join(f"{stamp},1,2,3\n" for stamp in stamps)
        (tmp_path / "a.csv").write_text("timestamp,nose.x,nose.y,nose.z\n" + rows)
        assert open_markers(str(tmp_path / "a.csv")).fps == fps


def test_a_file_that_is_not_there_and_markers_of_one_name_are_refused(tmp_path, points):
    with pytest.raises(InputError, match="no such file"):
        open_markers(str(tmp_path / "none.c3d"))
    for suffix in (".c3d", ".trc"):
        path = WRITERS[suffix](tmp_path / f"twice{suffix}", ["nose", "chin", "nose", "brow"], points)
        with pytest.raises(InputError, match="'nose' is there twice"):
            open_markers(str(path))


def test_a_c3d_file_without_points_is_refused(tmp_path, points):
    path = write_c3d(tmp_path / "take.c3d", NAMES, points)
    data = bytearray(path.read_bytes())
    data[2:4] = b"\0\0"
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match="without points"):
        open_markers(str(path))


def test_an_unknown_unit_is_left_to_a_guess(tmp_path, points):
    clip = open_markers(str(write_c3d(tmp_path / "take.c3d", NAMES, points, unit="furlong")))
    assert clip.unit_mm is None and "furlong" in clip.facts.notes[0]
