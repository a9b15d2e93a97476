"""The frames of glTF animations: what their keys' times tell, at which key a frame stands, and what is only a guess."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from riginv.clips.options import ReadingOptions
from riginv.errors import InputError
from rigs.gltf import GltfRig
from rigs.gltf.clip import GltfClip
from rigs.gltf.timing import Timing, timing_of
from tests.support.avatars import AvatarWriter, add_cube

NTSC = 1000 / 1001


def timed(*channels: np.ndarray, fps: float | None = None) -> Timing:
    """The timing of channels with keys at such times, as a file holds them."""
    return timing_of("clip.glb", [np.asarray(times, np.float32).astype(np.float64) for times in channels], fps)


@pytest.mark.parametrize("start", [0.0, 1 / 30, 7.0, 100.0, 10_000.0])
@pytest.mark.parametrize(
    "fps", [24, 25, 30, 40, 48, 50, 60, 72, 90, 100, 120, 144, 240, *(base * NTSC for base in (24, 30, 60, 120))]
)
def test_a_key_at_every_frame_tells_the_rate(fps, start):
    first = round(start * fps)
    timing = timed((first + np.arange(100)) / fps)
    assert timing.rate.fps == pytest.approx(fps, rel=1e-5)
    assert not timing.rate.note or (fps, start) == (240, 10_000)  # a quarter of a frame is the step of float32 there
    assert timing.count == 100 and timing.first == first


@pytest.mark.parametrize("start", [0.0137, 3.3333, 9_999.987])
@pytest.mark.parametrize("fps", [24, 25, 30, 60])
def test_frames_may_start_between_those_of_zero(fps, start):
    timing = timed(start + np.arange(50) / fps)
    assert timing.rate.fps == fps and timing.count == 50
    assert abs(timing.seconds()[0] - start) < 1e-3 and abs(timing.first / fps - start) <= 0.5 / fps + 1e-3


@pytest.mark.parametrize(
    ("keys", "fps", "guess"),
    [
        ([[0, 1, 2, 3]], 30, True),
        ([[0, 2.5, 7]], 30, True),
        ([[0, 1]], 30, True),
        ([[10_000, 10_001, 10_002.5]], 30, True),
        ([[0, 5 / 24, 17 / 24, 31 / 24, 60 / 24]], 24, True),
        ([[0, 5 / 24, 6 / 24, 31 / 24, 60 / 24]], 24, False),
        ([[0, 3 / 25, 4 / 25, 17 / 25]], 25, False),
        ([np.arange(12) / 12], 24, True),  # on twos
        ([np.arange(30) / 15], 30, True),
        ([[0, 0.4713, 1.9121]], 30, True),
        ([[1.5]], 30, True),
        ([np.arange(25) / 24, np.arange(31) / 30], 120, False),  # every key stands on a frame
        ([np.arange(31) / 30, np.arange(61) / 60, [0, 1]], 60, False),
        ([np.arange(30) / 30, [0, 0.9712]], 30, True),  # where a clip was cut
        ([np.sort(np.concatenate([np.arange(24), np.arange(1, 24) - 0.01])) / 24], 24, False),  # holds up to the next key
        ([np.round(np.arange(40) / 30, 3)], 30, False),
        ([np.round(np.arange(40) / 24, 2)], 24, False),
        ([np.round(np.arange(90) / 60, 4)], 60, False),
        ([np.arange(40) * 0.033], 30.303, False),
        ([np.cumsum(np.full(3000, 1 / 30, np.float32), dtype=np.float32)], 30, False),
        ([np.arange(90) / 60 + np.random.default_rng(0).uniform(-0.004, 0.004, 90)], 60, True),
    ],
)
def test_all_keys_are_evidence_and_a_guess_says_so(keys, fps, guess):
    rate = timed(*keys).rate
    assert rate.fps == pytest.approx(fps)
    assert bool(rate.note) == guess and rate.source
    if guess:
        assert rate.note.endswith(".") and f"{rate.fps:g}" in rate.note


def test_keys_seconds_apart_are_not_sampled_once_a_second():
    timing = timed([0, 1, 2, 3])
    assert timing.count == 91 and "24, 25" in timing.rate.note and "reading.fps" in timing.rate.note


def test_what_the_user_says_counts():
    for fps, count in ((24, 24), (60, 59), (12, 13), (23.976, 24)):
        timing = timed(np.arange(24) / 24, fps=fps)
        assert (timing.rate.fps, timing.rate.source, timing.rate.note) == (fps, "reading.fps", "") and timing.count == count


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (300_000 + np.arange(24) / 30, "where glTF's times are 0.0312 s apart"),
        (100_000 + np.arange(24) / 60, "expected a small part of a frame"),
        ([0, 1e7], "are more than can be meant"),
        ([-3e38, 3e38], "are more than can be meant"),
        ([3e38], "are more than can be meant"),
    ],
)
def test_times_that_tell_nothing_are_refused(times, said):
    with pytest.raises(InputError, match=said):
        timed(times)


def animated(path: Path, times: np.ndarray, weights: np.ndarray, how: str) -> tuple[GltfClip, np.ndarray, np.ndarray]:
    """A clip of a cube whose two weights `(key, 2)` are keyed, its rest `(8, 3)` and its deltas `(2, 8, 3)`, m."""
    avatar = AvatarWriter()
    node, points, deltas = add_cube(avatar, "head", ["a", "b"], 1)
    avatar.animation("take", (node, "weights", times, weights, how))
    return GltfClip(str(avatar.write(path)), ReadingOptions(), GltfRig(str(path))), points, deltas


@pytest.mark.parametrize("start", [0.0, 5.0, 1000.0])
@pytest.mark.parametrize("fps", [24, 25, 30, 48, 50, 60, 120, 24 * NTSC, 60 * NTSC])
@pytest.mark.parametrize("how", ["STEP", "LINEAR", "CUBICSPLINE"])
def test_a_frame_shows_its_own_key(how, fps, start, tmp_path):
    rng = np.random.default_rng(0)
    weights, times = rng.random((24, 2)), (round(start * fps) + np.arange(24)) / fps
    given = np.stack([rng.normal(size=(24, 2)), weights, rng.normal(size=(24, 2))], axis=1) if how == "CUBICSPLINE" else weights
    clip, points, deltas = animated(tmp_path / "a.glb", times, given, how)
    assert clip.fps == pytest.approx(fps) and clip.frame_numbers[0] == round(times[0] * fps) and len(clip) == 24
    expected = points + np.einsum("fk,kvc->fvc", weights, deltas)
    assert np.abs(clip.read(0, 24) - expected).max() < 1e-6
    assert np.abs(clip.read(7, 9) - expected[7:9]).max() < 1e-6
    assert (clip.facts.format, clip.facts.animation, clip.facts.rate_source) == (
        "glTF",
        "take",
        "the frames that its keys stand on",
    )


def test_values_between_keys_are_those_of_the_specification(tmp_path):
    rng = np.random.default_rng(1)
    times, weights = np.array([0, 5, 6, 13, 20]) / 24, rng.random((5, 2))
    frames = np.arange(21) / 24
    into, out = rng.normal(size=(2, 5, 2))
    splines = np.stack([into, weights, out], axis=1)
    between = [CubicHermiteSpline(times[key : key + 2], weights[key : key + 2], [out[key], into[key + 1]]) for key in range(4)]
    segments = np.minimum(np.searchsorted(times - 1e-9, frames, side="right") - 1, 3)
    cubic = np.stack([between[segment](time) for segment, time in zip(segments, frames)])
    linear = np.stack([np.interp(frames, times, column) for column in weights.T], axis=1)
    step = weights[np.searchsorted(times - 1e-9, frames, side="right") - 1]
    for how, given, expected in (("STEP", weights, step), ("LINEAR", weights, linear), ("CUBICSPLINE", splines, cubic)):
        clip, points, deltas = animated(tmp_path / "a.glb", times, given, how)
        assert len(clip) == 21
        assert np.abs(clip.read(0, 21) - points - np.einsum("fk,kvc->fvc", expected, deltas)).max() < 1e-6


def test_steps_that_linear_keys_imitate_jump_at_their_frame(tmp_path):
    """Two keys for each jump, one just before the frame or at the very time."""
    weights = np.random.default_rng(2).random((12, 2))
    for before in (1e-4, 0.0):
        times = np.stack([np.arange(12) / 30, np.arange(1, 13) / 30 - before], axis=1).reshape(-1)[:-1]
        clip, points, deltas = animated(tmp_path / "a.glb", times, np.repeat(weights, 2, axis=0)[:-1], "LINEAR")
        assert clip.fps == 30 and len(clip) == 12
        assert np.abs(clip.read(0, 12) - points - np.einsum("fk,kvc->fvc", weights, deltas)).max() < 1e-6


def test_keys_that_lost_their_times_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"keys 0 to 2 all stand at 1.76e\+09 s, expected times that rise"):
        animated(tmp_path / "a.glb", 1.76e9 + np.arange(24) / 30, np.zeros((24, 2)), "STEP")
    with pytest.raises(InputError, match="its times do not rise"):
        animated(tmp_path / "a.glb", np.array([0, 0.2, 0.1]), np.zeros((3, 2)), "STEP")


def test_a_single_key_is_one_frame_and_said_to_be(tmp_path):
    clip, points, deltas = animated(tmp_path / "a.glb", np.array([2.0]), np.array([[0.5, 0.25]]), "LINEAR")
    assert clip.frame_numbers.tolist() == [60] and clip.facts.rate_source == "a guess"
    assert (
        "has keys at one time: that pose was read" in clip.facts.notes[0]
        and "its keys all stand at one time" in clip.facts.notes[1]
    )
    assert np.abs(clip.read(0, 1)[0] - points - 0.5 * deltas[0] - 0.25 * deltas[1]).max() < 1e-6
