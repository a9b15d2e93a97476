"""Rows of recordings are placed by their timecodes, whatever these count, and whatever is missing among them."""

from pathlib import Path

import numpy as np
import pytest

from riginv.clips.timecode import Timing, timing
from riginv.errors import InputError
from tests.support.takes import drop_frame, timecode


def placed(codes: list[str]) -> Timing:
    return timing(Path("take.csv"), codes, list(range(2, len(codes) + 2)))


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize(
    ("fps", "count"),
    [
        (30, 60),
        (60, 60),
        (24, 60),
        (25, 60),
        (24, 24),
        (25, 25),
        (30, 30),
        (24, 30),
        (25, 30),
        (50, 50),
        (120, 120),
        (60, 1000),
    ],
)
def test_rates_and_counts_are_told_by_all_rows(fps, count, cut):
    found = placed([timecode(300 + frame, fps, count, cut) for frame in range(200)])
    assert found.fps == pytest.approx(fps, abs=1e-3)
    assert found.frame_numbers.tolist() == list(range(200))
    assert bool(found.notes) == (count != 60)  # what is not the app's is said
    assert all(f"count {count} frames a second" in note for note in found.notes)


def test_rows_that_are_missing_leave_gaps():
    codes = [timecode(frame, 30, 60) for frame in range(200) if frame not in (40, 41, 150) and not 60 <= frame < 120]
    found = placed(codes)
    assert found.fps == 30 and found.frame_numbers[-1] == 199 and len(found.frame_numbers) == 137
    assert any("rows are missing: 63 in all, at most 60" in note for note in found.notes)
    assert placed([timecode(frame, 25, 25) for frame in range(100) if frame != 50]).frame_numbers[-1] == 99


def test_a_take_goes_on_past_midnight():
    found = placed([timecode(frame, 30, 60) for frame in range(24 * 3600 * 30 - 50, 24 * 3600 * 30 + 50)])
    assert found.fps == 30 and found.frame_numbers.tolist() == list(range(100)) and not found.notes


@pytest.mark.parametrize("first", [1700, 17900, 30 * 60 * 20])
def test_drop_frame_timecodes_leave_no_gap_where_numbers_are_dropped(first):
    found = placed([drop_frame(frame) for frame in range(first, first + 200)])
    assert found.fps == pytest.approx(30000 / 1001) and found.frame_numbers.tolist() == list(range(200))


def test_drop_frame_that_drops_nothing_is_said():
    found = placed([timecode(frame, 30, 30, True, ";") for frame in range(1700, 1900)])
    assert found.frame_numbers.tolist() == list(range(200)) and any("drop-frame leaves out" in note for note in found.notes)


def test_repeated_timecodes():
    codes = [timecode(frame, 30, 60) for frame in range(90)]
    once = placed([*codes[:20], codes[19], *codes[20:]])
    assert (
        once.kept.tolist() == [row for row in range(91) if row != 20] and "left out: 1, the first in line 22" in once.notes[0]
    )
    twice = placed([timecode(frame // 2, 30, 30, True) for frame in range(300)])  # 60 a second with whole timecodes of 30
    assert twice.fps == 60 and twice.frame_numbers.tolist() == list(range(300))
    same = placed(["00:00:00:00.000"] * 8)
    assert same.fps == 60 and same.frame_numbers.tolist() == list(range(8)) and "one timecode" in same.notes[0]


def test_a_timecode_that_goes_back_is_said_and_its_rows_follow():
    codes = [timecode(frame, 30, 60) for frame in (*range(60, 120), *range(60))]
    found = placed(codes)
    assert found.fps == 30 and found.frame_numbers.tolist() == list(range(120)) and "goes back in line 62" in found.notes[0]


def test_a_take_that_slows_down_is_counted_at_its_finer_rate():
    codes = [timecode(frame, 60, 60) for frame in range(100)] + [timecode(frame, 30, 60) for frame in range(50, 150)]
    found = placed(codes)
    assert found.fps == 60 and found.frame_numbers[99] == 99 and found.frame_numbers[-1] == 298


@pytest.mark.parametrize("jitter", [0.05, 0.15])
def test_jitter_does_not_drift(jitter):
    shaken = np.arange(4000) + np.random.default_rng(0).normal(size=4000) * jitter
    found = placed([timecode(max(frame, 0), 30, 60) for frame in 150 + shaken])
    assert found.fps == pytest.approx(30, abs=0.01) and found.frame_numbers.tolist() == list(range(4000))


def test_what_cannot_be_told_is_said():
    assert "60 taken" in placed([f"00:00:00:{frame:02d}" for frame in range(24)]).notes[0]
    assert placed(["10:00:00:00.000"]).fps == 60
    assert placed([f"00:00:{frame / 30:06.3f}" for frame in range(100)]).fps == pytest.approx(30, abs=0.01)


@pytest.mark.parametrize(
    "code", ["", "12", "00:00:00", "a:b:c:d", "00:00:00:00:00", "00:61:00:00", "25:00:00:00.0", "-1:00:00:00"]
)
def test_what_is_no_timecode_is_refused_at_its_line(code):
    with pytest.raises(InputError, match=r"take.csv, line 4, column Timecode: found"):
        placed(["00:00:00:00.000", "00:00:00:01.000", code, "00:00:00:03.000"])
