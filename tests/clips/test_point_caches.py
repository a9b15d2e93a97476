"""Point caches: what their headers and times mean, and what contradicts itself is said."""

import struct
from pathlib import Path

import numpy as np
import pytest

from riginv.clips.open import open_sequence
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence
from riginv.clips.times import frames_from_times
from riginv.clips.units import resolve_units
from riginv.errors import InputError
from tests.support.clips import performance, write_mdd, write_pc2
from tests.support.toys import ToyRig

RIG = ToyRig(detail=1)
MESHES = performance(RIG, 8)


def pc2(
    path: Path, start: float = 0.0, rate: float = 1.0, order: str = "<", version: int = 1, more: bytes = b""
) -> MeshSequence:
    header = b"POINTCACHE2\0" + struct.pack(f"{order}iiffi", version, MESHES.shape[1], start, rate, len(MESHES))
    path.write_bytes(header + MESHES.astype(f"{order}f4").tobytes() + more)
    return open_sequence(str(path), RIG, ReadingOptions())


def mdd(path: Path, times: np.ndarray, order: str = ">", more: bytes = b"") -> MeshSequence:
    header = struct.pack(f"{order}2i", *MESHES.shape[:2]) + np.asarray(times).astype(f"{order}f4").tobytes()
    path.write_bytes(header + MESHES.astype(f"{order}f4").tobytes() + more)
    return open_sequence(str(path), RIG, ReadingOptions())


def said(sequence: MeshSequence) -> str:
    assert np.abs(sequence.read(0, 8) - MESHES).max() < 1e-4
    assert all(note.endswith(".") for note in sequence.facts.notes)
    return " ".join(sequence.facts.notes)


def seconds(sequence: MeshSequence) -> float:
    """From the first frame to the last, as the commands count."""
    fps = resolve_units(sequence, RIG, ReadingOptions(unit="mm", up="y")).fps
    return float(sequence.frame_numbers[-1] - sequence.frame_numbers[0]) / fps


@pytest.mark.parametrize(
    "start, rate, numbers",
    [(0, 1, range(8)), (1001, 1, range(1001, 1009)), (-3, 2, range(-3, 13, 2)), (10, 5, range(10, 50, 5))],
)
def test_whole_frames_of_a_pc2_are_numbered_as_it_says(start, rate, numbers, tmp_path):
    sequence = pc2(tmp_path / "a.pc2", start, rate)
    assert said(sequence) == "" and sequence.frame_numbers.tolist() == list(numbers) and sequence.fps is None


@pytest.mark.parametrize("start, rate", [(1, 0.5), (0, 0.25), (100, 0.2), (0, 2.5), (-2, 0.125)])
def test_samples_between_frames_are_frames_of_their_own(start, rate, tmp_path):
    sequence = pc2(tmp_path / "a.pc2", start, rate)
    assert f"a sample every {rate:g} frames" in said(sequence) and "reading.fps" in said(sequence)
    assert sequence.frame_numbers.tolist() == [round(start / rate) + number for number in range(8)]
    assert sequence.fps == 30 / rate and seconds(sequence) == pytest.approx(7 * rate / 30)


@pytest.mark.parametrize(
    "start, rate, note",
    [
        (0.5, 1, "starts at frame 0.5"),
        (0, 0, "every 0 frames makes no sense"),
        (0, -1, "every -1 frames"),
        (float("nan"), 1, "frame nan makes"),
        (3e30, 1, "makes no sense"),
        (0, float("inf"), "every inf frames"),
    ],
)
def test_a_start_or_rate_that_makes_no_sense_is_said(start, rate, note, tmp_path):
    sequence = pc2(tmp_path / "a.pc2", start, rate)
    assert note in said(sequence) and sequence.frame_numbers.tolist() == list(range(8)) and seconds(sequence) == 7 / 30


TIMES = {
    "24": (np.arange(8) / 24, 24, range(8)),
    "from frame 1": (np.arange(1, 9) / 30, 30, range(1, 9)),
    "ntsc": (np.arange(1001, 1009) * 1.001 / 24, 24 / 1.001, range(1001, 1009)),
    "sixty": (np.arange(8) / 60 + 2, 60, range(120, 128)),
    "late": (10_000 + np.arange(8) / 25, 25, range(250_000, 250_008)),
    "a gap": (np.array([0, 1, 2, 3, 9, 10, 11, 12]) / 50, 50, [0, 1, 2, 3, 9, 10, 11, 12]),
    "slow": (np.arange(8) / 6, 6, range(8)),
    "before zero": (np.arange(-4, 4) / 24, 24, range(-4, 4)),
}


@pytest.mark.parametrize("name", TIMES)
def test_times_in_seconds_give_rate_and_frames(name, tmp_path):
    times, fps, numbers = TIMES[name]
    sequence = mdd(tmp_path / "a.mdd", times)
    assert ("4" not in name or said(sequence) == "") and sequence.fps == pytest.approx(fps, rel=1e-6)
    assert sequence.frame_numbers.tolist() == list(numbers) and sequence.facts.rate_source == "its times"
    assert ("5 frames are missing" in said(sequence)) == (name == "a gap")


@pytest.mark.parametrize(
    "times, numbers",
    [
        (range(8), range(8)),
        (range(1, 9), range(1, 9)),
        (range(1001, 1009), range(1001, 1009)),
        (range(1, 17, 2), range(1, 17, 2)),
        ([1, 2, 3, 4, 5, 9, 10, 11], [1, 2, 3, 4, 5, 9, 10, 11]),
    ],
)
def test_times_that_are_frames_are_taken_for_frames(times, numbers, tmp_path):
    sequence = mdd(tmp_path / "a.mdd", np.array(list(times)))
    assert "are frames and not seconds" in said(sequence) and "30 frames a second" in said(sequence)
    assert sequence.fps is None and sequence.frame_numbers.tolist() == list(numbers)


def test_times_in_half_frames_and_milliseconds(tmp_path):
    halves = mdd(tmp_path / "a.mdd", 1 + np.arange(8) / 2)
    assert "60 samples a second" in said(halves) and seconds(halves) == pytest.approx(3.5 / 30)
    for times in (np.arange(8) * 1000 / 24, np.round(np.arange(8) * 1000 / 24)):
        milliseconds = mdd(tmp_path / "a.mdd", times)
        assert "in milliseconds" in said(milliseconds) and milliseconds.fps == pytest.approx(24, rel=0.01)


@pytest.mark.parametrize(
    "times, note",
    [
        (np.zeros(8), "do not rise"),
        (np.arange(8)[::-1] / 24, "do not rise"),
        (np.full(8, np.nan), "not all numbers"),
        (np.arange(8) * 1e-5, "implausible"),
        ([0, 1, 2, 4, 4.5, 6, 7.2, 8], "uneven"),
    ],
)
def test_times_that_tell_nothing_are_said(times, note, tmp_path):
    sequence = mdd(tmp_path / "a.mdd", np.asarray(times))
    assert note in said(sequence) and sequence.fps is None and sequence.frame_numbers.tolist() == list(range(8))


def test_uneven_times_give_the_rate_that_they_have_in_all(tmp_path):
    times = np.arange(8) / 30 + np.array([0, 3, -4, 2, -3, 4, -2, 0]) / 1000
    sequence = mdd(tmp_path / "a.mdd", times)
    assert "are uneven" in said(sequence) and sequence.fps == pytest.approx(30, rel=0.01)


@pytest.mark.parametrize("write, order, usual", [(pc2, ">", "little"), (mdd, "<", "big")])
def test_the_other_byte_order_is_read_where_only_it_fits(write, order, usual, tmp_path):
    times = {"times": np.arange(8) / 24} if write is mdd else {"start": 5.0}
    sequence = write(tmp_path / f"a.{write.__name__}", **times, order=order)
    assert f"is {usual}-endian; this file is" in said(sequence) and len(sequence) == 8
    with pytest.raises(InputError, match="damaged, without any frame|promises"):  # it must fit to the byte
        write(tmp_path / f"a.{write.__name__}", **times, order=order, more=b"\0")


@pytest.mark.parametrize("write", [pc2, mdd])
@pytest.mark.parametrize("frames, more", [(0, 1), (0, 11), (1, 0), (3, 5)])
def test_what_lies_behind_the_frames_of_the_header_is_said(write, frames, more, tmp_path):
    times = {"times": np.arange(8) / 24} if write is mdd else {}
    extra = b"\0" * (frames * 12 * MESHES.shape[1] + more)
    sequence = write(tmp_path / f"a.{write.__name__}", **times, more=extra)
    assert f"{len(extra):,} bytes after the 8 frames" in said(sequence) and len(sequence) == 8
    assert (f"enough for {frames} frames more" in said(sequence)) == bool(frames)
    path = tmp_path / f"a.{write.__name__}"
    path.write_bytes(path.read_bytes()[: -len(extra) - 1])
    with pytest.raises(InputError, match="truncated"):
        open_sequence(str(path), RIG, ReadingOptions())


def test_another_version_of_pc2_is_said(tmp_path):
    assert "PC2 of version 2" in said(pc2(tmp_path / "a.pc2", version=2))


def test_files_of_the_other_writer_are_as_they_were(tmp_path):
    for sequence in (write_mdd(tmp_path / "b.mdd", MESHES), write_pc2(tmp_path / "b.pc2", MESHES)):
        assert said(open_sequence(str(sequence), RIG, ReadingOptions())) == ""


def test_random_times_come_back():
    """Any usual rate, any start, any gaps, in single and double precision: the same frames at the same rate."""
    random = np.random.default_rng(3)
    for _ in range(1000):
        fps = float(random.choice([12, 24, 24 / 1.001, 25, 30, 30 / 1.001, 48, 50, 60, 60 / 1.001, 120]))
        first, count = int(random.integers(-100, 20_000)), int(random.integers(20, 200))
        steps = np.where(random.random(count - 1) < 0.05, random.integers(2, 9, count - 1), 1)
        numbers = first + np.concatenate([[0], np.cumsum(steps)])
        found = frames_from_times((numbers / fps).astype(random.choice([np.float32, np.float64])), "times")
        assert found.fps == pytest.approx(fps, rel=1e-9), (fps, first, count)
        assert found.numbers.tolist() == numbers.tolist()
