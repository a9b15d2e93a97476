"""Which times of a stage are frames: rates, ranges, and samples between frames; skipped where usd-core is not installed."""

import numpy as np
import pytest

from riginv.errors import InputError
from rigs.usd.frame_grid import frame_grid
from rigs.usd.stage_clock import StageClock, UnusableStageError
from tests.support.usd_stages import add_mesh, new_stage, opened

FRAMES = np.arange(1001.0, 1025.0)


def grid(samples, rate=24.0, **clock):
    return frame_grid(np.unique(np.asarray(samples, np.float64)), StageClock(rate, **clock))


@pytest.mark.parametrize(
    ("rates", "fps", "source"),
    [
        ((30.0, None), 30, "timeCodesPerSecond"),
        ((None, 25.0), 25, "framesPerSecond"),
        ((25.0, 25.0), 25, "timeCodesPerSecond"),
        ((None, None), 24, "USD's fallback of 24 time codes a second"),
    ],
)
def test_the_rate_is_what_usd_defines(rates, fps, source):
    found = frame_grid(FRAMES, StageClock(*rates))
    assert (found.fps, found.source) == (fps, source)
    assert found.numbers.tolist() == found.times.tolist() == FRAMES.tolist()
    assert bool(found.notes) == (rates == (None, None))


@pytest.mark.parametrize("around", [(-0.25, 0, 0.25), (0, 0.5), (-0.2, 0, 0.2, 0.4), (-0.25, 0.25), (-0.5, -0.25, 0)])
def test_samples_around_each_frame_make_one_frame_each(around):
    found = grid([frame + offset for frame in FRAMES for offset in around], start=1001.0, end=1024.0)
    assert found.fps == 24 and found.times.tolist() == FRAMES.tolist() and found.numbers.tolist() == FRAMES.tolist()
    assert any("motion blur" in note for note in found.notes)


@pytest.mark.parametrize(
    ("samples", "clock", "fps", "count", "first"),
    [
        (np.arange(60) * 0.4, {}, 60, 60, 0),  # 60 frames a second on a clock of 24
        (1001 + np.arange(60) * 0.8, {}, 30, 60, 1251),
        (np.round(np.arange(60) * 1000 / 30), {"rate": 1000.0}, 30, 60, 0),  # milliseconds
        (np.delete(np.round(np.arange(60) * 1000 / 30), [5, 6]), {"rate": 1000.0}, 30, 60, 0),
        (np.arange(60) * 40, {"rate": 1000.0, "frames_per_second": 25.0}, 25, 60, 0),
        (10_000 + np.arange(60) / 30, {"rate": 1.0}, 30, 60, 300_000),  # seconds
        ((10_000 + np.arange(60) / 30).astype(np.float32), {"rate": 1.0}, 30, 60, 300_000),
        ([0, 1, 2], {"rate": 1.0, "frames_per_second": 24.0}, 24, 49, 0),  # keys seconds apart
        ([0, 1, 2], {"rate": 1.0}, 24, 49, 0),
        (np.arange(1, 25, 2), {}, 24, 23, 1),  # animated on twos
        (np.arange(0, 48, 2), {"rate": 48.0, "frames_per_second": 24.0}, 24, 24, 0),
        (FRAMES, {"frames_per_second": 30.0}, 24, 24, 1001),  # the samples decide
        (np.arange(0, 24, 0.5), {"requested": 48.0}, 48, 48, 0),
        (np.arange(0, 24, 0.5), {}, 24, 24, 0),
        (np.arange(0.5, 20), {}, 24, 20, 0),
        (np.arange(-10, 11), {}, 24, 21, -10),
        (FRAMES + np.random.default_rng(0).uniform(-0.05, 0.05, 24), {}, 24, 24, 1001),
    ],
)
def test_clocks_that_count_something_else_than_frames(samples, clock, fps, count, first):
    found = grid(samples, **clock)
    assert found.fps == pytest.approx(fps, rel=1e-6) and len(found.numbers) == len(found.times) == count
    assert found.numbers[0] == first and (np.diff(found.numbers) == 1).all() and (np.diff(found.times) > 0).all()


@pytest.mark.parametrize(
    ("samples", "ends", "first", "last", "said"),
    [
        ([1, 24], (1, 24), 1, 24, "22 of 24 frames have no sample"),
        (range(5, 11), (1, 24), 1, 24, "holds the first and the last"),
        (range(1, 101), (1, 24), 1, 100, "frames.last"),
        (range(1, 101), (1001, 1024), 1, 100, "lie beside all its samples"),
        (range(1, 25), (24, 1), 1, 24, "no range"),
        (range(1, 25), (float("nan"), 24), 1, 24, "no range"),
    ],
)
def test_the_stages_range_and_its_samples_both_count(samples, ends, first, last, said):
    found = grid(list(samples), start=float(ends[0]), end=float(ends[1]))
    assert found.numbers.tolist() == list(range(first, last + 1))
    assert any(said in note for note in found.notes)


@pytest.mark.parametrize("samples", [[], [7.0]])
def test_a_still_is_said(samples):
    found = grid(samples, start=1.0, end=24.0)
    assert (
        found.numbers.tolist() == (samples or [1]) and "one still frame was read" in found.notes[0] and "24" in found.notes[0]
    )


@pytest.mark.parametrize(
    ("samples", "clock", "said"),
    [
        ([0, 1e12], {}, "more than 10,000,000 frames"),
        ([0, 1], {"start": 0.0, "end": 1e15}, "more than"),
        ([0, np.inf], {}, "damaged"),
        ([1e300, 1.1e300, 1.2e300, 1.3e300], {}, "damaged"),
        (FRAMES, {"rate": 0.0}, "timeCodesPerSecond is 0, expected a number above 0"),
        (FRAMES, {"rate": float("nan")}, "timeCodesPerSecond is nan"),
    ],
)
def test_times_that_cannot_be_meant_are_refused(samples, clock, said):
    with pytest.raises(UnusableStageError, match=said):
        grid(samples, **clock)
    assert grid(FRAMES, 0.0, requested=25.0).numbers.tolist() == FRAMES.tolist()


def test_points_are_those_at_the_frame_and_interpolated_as_usd_does(tmp_path):
    stage = new_stage(tmp_path / "a.usda", None)
    stage.SetFramesPerSecond(25)
    mesh = add_mesh(stage, "/Head")
    rest = np.array(mesh.GetPointsAttr().Get())
    for time in (0, 3.75, 4, 4.25, 10):
        mesh.GetPointsAttr().Set((rest + np.float32(time**2)).astype(np.float32), time)
    stage.Save()
    clip = opened(tmp_path / "a.usda")
    expected = rest[None] + np.interp(np.arange(11), [0, 3.75, 4, 10], [0, 3.75**2, 16, 100])[:, None, None]
    expected[5:10] = rest + np.interp(np.arange(5, 10), [4.25, 10], [4.25**2, 100])[:, None, None]
    assert np.abs(clip.read(0, 11) - expected).max() < 1e-4
    assert clip.fps == 25 and clip.facts.rate_source == "framesPerSecond" and clip.facts.format == "USD"


def test_a_rate_that_is_none_is_refused_with_the_files_name(tmp_path):
    stage = new_stage(tmp_path / "a.usda", -24.0)
    add_mesh(stage, "/Head")
    stage.Save()
    with pytest.raises(InputError, match=r"a.usda: timeCodesPerSecond is -24, expected a number above 0: .*reading.fps"):
        opened(tmp_path / "a.usda")
    assert opened(tmp_path / "a.usda", fps=25.0).frame_numbers.tolist() == [0]
