"""What was read of a clip is said as it is: frames and gaps, rate, size, what was left out, and motion that can hardly be."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from riginv.clips.clip import Clip
from riginv.clips.description import ClipDescription, describe
from riginv.clips.description_text import LONGEST_LINE, in_short, line, rows, show_clip
from riginv.clips.open import open_clip, open_sequence
from riginv.clips.options import FrameOptions
from riginv.clips.sequence import MeshSequence, SourceFacts
from riginv.clips.units import resolve_units, resolve_units_without_rig
from riginv.errors import InputError
from tests.support.clips import obj_sequence, performance, reading_options, write_mdd, write_npz, write_pc2
from tests.support.toys import ToyRig


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig()


@pytest.fixture(scope="module")
def meshes(rig) -> np.ndarray:
    return performance(rig, 24)


class Made(MeshSequence):
    """Meshes as a reader of scenes would give them, which counts how many frames it was asked for."""

    def __init__(self, meshes: np.ndarray, facts: SourceFacts, **more) -> None:
        self.meshes, self.asked = meshes.astype(np.float32), 0
        numbers = more.pop("numbers", np.arange(len(meshes)))
        super().__init__("scene.usd", numbers, meshes.shape[1], facts=facts, **more)

    def read(self, start: int, stop: int) -> np.ndarray:
        self.asked += stop - start
        return self.meshes[start:stop]


def described(path: Path | str, rig: ToyRig, frames: FrameOptions | None = None, **reading) -> ClipDescription:
    return describe(open_clip(str(path), rig, reading_options(**reading), frames or FrameOptions())[0])


def saved(path: Path, meshes: np.ndarray, **more) -> Path:
    np.savez(path, vertices=meshes.astype(np.float32), **more)
    return path


def test_one_line_says_it_all(rig, meshes, tmp_path):
    found = described(write_npz(tmp_path / "take.npz", meshes / 10, rig.faces.numpy()), rig)
    size = " x ".join(f"{side:.3g}" for side in np.ptp(meshes[0], axis=0))
    assert line(found) == (
        f"clip take.npz: NumPy .npz, mesh vertices, 24 frames 0 to 23, 24 fps (its array fps), 0.9583 s, {size} mm, "
        f"unit cm (guessed), y up (guessed)"
    )
    assert found.warnings == () and found.seconds == pytest.approx(23 / 24)
    away = np.linalg.norm(meshes - meshes[0], axis=2).max()
    speed = np.linalg.norm(np.diff(meshes, axis=0), axis=2).max() * 24 / 1000
    assert found.motion.farthest_mm == pytest.approx(away, rel=1e-4)
    assert found.motion.fastest_m_s == pytest.approx(speed, rel=1e-3)
    assert ("vertices", "162, 320 faces") in rows(found)


def test_what_a_scene_held_and_what_was_passed_over(rig, meshes):
    many = tuple(f"mesh_{number}" for number in range(40))
    facts = SourceFacts("USD", ("head",), many, "talk", ("idle", "walk"), "timeCodesPerSecond", ("a note.",))
    found = describe(as_clip(Made(meshes, facts, fps=30.0, unit_mm=1.0, up="y"), rig))
    said = line(found)
    for words in (
        "USD, mesh head (40 left out)",
        "animation talk (2 ignored)",
        "30 fps (timeCodesPerSecond)",
        "unit mm",
    ):
        assert words in said
    table = dict(rows(found))
    assert table["animations ignored"] == "idle, walk" and "mesh_11 and 28 more" in table["meshes left out"]
    assert dict(rows(found, None))["meshes left out"] == ", ".join(many)
    assert found.as_json()["other_meshes"] == list(many) and "a note." in found.as_json()["notes"]


def as_clip(sequence: MeshSequence, rig: ToyRig, **frames) -> Clip:
    return Clip(sequence, resolve_units(sequence, rig, reading_options()), **frames)


def test_a_line_is_short_whatever_names_the_file_has(rig, meshes):
    facts = SourceFacts("F" * 30, ("m" * 300,), ("n",) * 3000, "a" * 300, ("b",) * 2000, "r" * 300)
    numbers = np.arange(24) * 1000 + 10**9
    sequence = Made(meshes, facts, fps=23.976, unit_mm=1.0, up="y", numbers=np.delete(numbers, 3)[:23])
    sequence.meshes = sequence.meshes[:23]
    said = line(describe(as_clip(sequence, rig)))
    assert len(said) <= LONGEST_LINE and said.startswith("clip scene.usd: ") and "(1 missing" in said
    evil = SourceFacts("USD", ("he\x1b[31mad\n",), (), "ta\u2028lk")
    found = describe(as_clip(Made(meshes, evil, fps=30.0, unit_mm=1.0, up="y"), rig))
    assert "mesh he?[31mad?" in line(found) and "animation ta?lk" in line(found)
    assert all(text.isprintable() for row in rows(found) for text in row)


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ([0, 1, 2, 5, 6, 7, 8, 9], "8 frames 0 to 9 (2 missing: 3, 4)"),
        ([1001, 1003, 1005, 1009, 1011, 1021], "6 frames 1001 to 1021 (5 missing: 1007, 1013, 1015, ...)"),
        ([-3, -2, -1, 0, 10**12], "5 frames -3 to 1000000000000 (999,999,999,999 missing: 1, 2, 3, ...)"),
        ([10, 20, 30, 40], "4 frames 10 to 40"),
        ([7], "1 frame, 7"),
    ],
)
def test_gaps_are_counted_and_the_first_are_named(numbers, said, rig, meshes, tmp_path):
    path = saved(tmp_path / "gaps.npz", meshes[: len(numbers)], frame_numbers=np.array(numbers), fps=24.0)
    found = described(path, rig)
    assert f"NumPy .npz, mesh vertices, {said}, 24 fps" in in_short(found, 300)
    assert found.as_json()["frames"]["missing"] == found.missing


def test_frames_that_were_left_out_or_are_not_known(rig, meshes, tmp_path):
    path = saved(tmp_path / "take.npz", meshes, fps=24.0)
    found = described(path, rig, FrameOptions(5, 20, ["7-8", 12]))
    assert "16 frames 5 to 20 of 0 to 23 (3 excluded)" in line(found)
    assert found.as_json()["frames"] == {"first": 5, "last": 20, "count": 16, "missing": 0, "excluded": 3}
    holes = meshes.copy()
    holes[3:5] = np.nan
    assert "24 frames 0 to 23 (2 not known)" in line(described(saved(tmp_path / "holes.npz", holes, fps=24.0), rig))


def test_what_is_given_counts_as_given(rig, meshes, tmp_path):
    path = saved(tmp_path / "take.npz", meshes[:, :, [0, 2, 1]] * [1, -1, 1] / 1000)
    found = described(path, rig, unit="m", up="z", fps=60)
    for words in ("60 fps (as given)", "unit m (as given)", "z up (as given)"):
        assert words in line(found)
    np.testing.assert_allclose(found.motion.size_mm, np.ptp(meshes[0], axis=0), rtol=1e-4)
    assert "30 fps (guessed)" in line(described(path, rig, up="z"))


@pytest.mark.parametrize("write", [write_npz, write_mdd, write_pc2], ids=["npz", "mdd", "pc2"])
def test_a_clip_that_never_moves_is_said_to_be_so(write, rig, meshes, tmp_path):
    still = np.repeat(meshes[:1], 300, axis=0)
    more = (rig.faces.numpy(),) if write is write_npz else ()
    found = described(write(tmp_path / f"still.{write.__name__[6:]}", still, *more), rig)
    (warning,) = found.warnings
    assert warning.startswith("it never moves: the 96 of 300 frames looked at are all the same mesh (reading.mesh and ")
    assert found.motion.fastest_m_s == 0


def test_a_clip_that_moves_where_nobody_looked_is_not_said_to_be_still_once_it_was_read(rig, meshes, tmp_path):
    still = np.repeat(meshes[:1], 1000, axis=0)
    still[100:110] = meshes[12]
    clip, _ = open_clip(str(saved(tmp_path / "rare.npz", still, fps=24.0)), rig, reading_options(), FrameOptions())
    before = describe(clip)
    assert before.motion.frames == 96 and "never moves" in before.warnings[0]
    for _ in clip.batches(64):
        pass
    assert describe(clip).warnings == () and describe(clip).motion.frames == 1000


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (
            np.repeat(np.arange(12), 2),
            "every mesh is there 2 times in a row: written at 30 frames a second and animated at about 15",
        ),
        (
            np.repeat(np.arange(8), 5),
            "every mesh is there 5 times in a row: written at 30 frames a second and animated at about 6",
        ),
        (np.arange(60) * 4 // 5 % 24, "12 of 59 frames are the same as the one before: written at 30"),  # 24 as 30 a second
        (np.repeat(np.arange(24), [2, 3] * 12), "frames are the same as the one before: written at 30"),  # pulldown
    ],
    ids=["twice", "five times", "24 as 30", "pulldown"],
)
def test_frames_that_repeat_are_said_to(rows, said, rig, meshes, tmp_path):
    path = saved(tmp_path / "repeated.npz", meshes[rows], fps=30.0)
    (warning,) = described(path, rig).warnings
    assert warning.startswith("its frames repeat: ") and said in warning
    pattern = obj_sequence(tmp_path / "obj", meshes[rows], rig.faces.numpy())
    assert said.partition(":")[0] in described(pattern, rig).warnings[0]


def test_a_pose_that_is_held_is_no_repetition(rig, meshes, tmp_path):
    held = meshes[[*range(12), *[12] * 30, *range(13, 24), *[23] * 20]]
    assert described(saved(tmp_path / "held.npz", held, fps=30.0), rig).warnings == ()
    noise = np.random.default_rng(0).normal(0, 0.01, (48, 162, 3))  # captured: no frame is the one before
    assert described(saved(tmp_path / "noisy.npz", meshes[np.repeat(np.arange(24), 2)] + noise, fps=30.0), rig).warnings == ()


def test_what_moves_faster_than_people_is_said_to(rig, meshes, tmp_path):
    wild = meshes.copy()
    wild[10:, 17] += [0.0, 5000.0, 0.0]
    (warning,) = described(saved(tmp_path / "wild.npz", wild, fps=24.0), rig).warnings
    assert warning.startswith("it moves too fast: vertex 17 at 120 m/s from frame 9 to 10, people at up to 20:")
    travel = meshes + np.linspace(0, 1500, 24)[:, None, None]  # a walk: 2.7 m/s
    assert described(saved(tmp_path / "walk.npz", travel, fps=24.0), rig).warnings == ()
    quick = described(saved(tmp_path / "quick.npz", travel, fps=24.0), rig, fps=600)  # and far too fast at another rate
    assert "it moves too fast" in quick.warnings[0] and quick.motion.fastest_m_s == pytest.approx(68, rel=0.1)
    gaps = saved(tmp_path / "gaps.npz", travel[::6], fps=240.0, frame_numbers=np.arange(4) * 60)  # the time of a gap counts
    assert described(gaps, rig).warnings == ()


def test_only_a_bounded_number_of_frames_is_looked_at(rig, meshes):
    sequence = Made(np.resize(meshes, (5000, *meshes.shape[1:])), SourceFacts("USD"), fps=30.0, unit_mm=1.0, up="y")
    clip = as_clip(sequence, rig)
    sequence.asked = 0
    assert describe(clip).motion.frames == 96 and sequence.asked == 96
    describe(clip)
    assert sequence.asked == 96  # nothing is read twice


def test_without_a_rig_lengths_are_in_the_files_unit(rig, meshes, tmp_path):
    sequence = open_sequence(str(saved(tmp_path / "take.npz", meshes / 7, fps=24.0)), None, reading_options())
    found = describe(Clip(sequence, resolve_units_without_rig(sequence, reading_options())))
    assert "units, unit not known" in line(found) and found.unit_mm is None and found.motion.fastest_m_s == 0
    np.testing.assert_allclose(found.as_json()["size"], np.ptp(meshes[0] / 7, axis=0), rtol=1e-4)
    given = describe(Clip(sequence, resolve_units_without_rig(sequence, reading_options(unit="cm", scale=0.7, up="y"))))
    assert given.unit_mm == pytest.approx(7) and "unit 7 mm (as given)" in line(given)
    with pytest.raises(InputError, match="reading.unit is 'ell'"):
        reading_options(unit="ell")


def test_facts_stand_beside_the_curves_and_on_the_page(run: Callable, rig, meshes, tmp_path):
    path = write_npz(tmp_path / "twice.npz", meshes[np.repeat(np.arange(8), 2)], rig.faces.numpy(), fps=30.0)
    options = ("look.sheet=false", "method=levenberg_marquardt", "motion=keep")
    outcome = run("invert", "rig=toy", f"--config-dir={Path(__file__).parents[1] / 'conf'}", f"clip={path}", "out=o", *options)
    assert outcome.code == 0, outcome.text
    said = outcome.text.splitlines()
    first = next(
        number
        for number, text in enumerate(said)
        if text.startswith("clip twice.npz: NumPy .npz, mesh vertices, 16 frames 0 to 15")
    )
    assert said[first + 1].startswith("warning: its frames repeat: every mesh is there 2 times in a row")
    assert said[first + 2].startswith("rig toy: 7 controls, 162 vertices, 320 faces, 100 mm tall (100 x 100 x 100 mm)")
    facts = json.loads((tmp_path / "o/curves.json").read_text())["clip"]
    assert facts["frames"]["count"] == 16 and facts["unit_source"] == "guessed" and "repeat" in facts["warnings"][0]
    page = (tmp_path / "o/look.html").read_text()
    assert "its frames repeat" in page and "16 frames 0 to 15" in page


def test_sets_that_no_file_was_read_for_are_not_described():
    assert show_clip(None) is None
