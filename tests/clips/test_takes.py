"""Live Link Face recordings of every make: what their columns are, how their numbers are written, which rigs they move."""

from pathlib import Path

import numpy as np
import pytest

from riginv.clips.live_link import read_live_link
from riginv.clips.open import open_sequence
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence
from riginv.errors import InputError
from riginv.rig.arkit import ARKIT_NAMES, arkit_parts, plain_name
from rigs.shapes import ShapesRig
from tests.support import sculpts
from tests.support.clips import performance, write_npz
from tests.support.takes import curves, timecode, write_take
from tests.support.toys import ToyRig

FRAMES = 12
CODES = [timecode(22 + frame, 30, 60) for frame in range(FRAMES)]


def rig_of(folder: Path, *names: str) -> ShapesRig:
    offsets = {name: sculpts.POINTS + sculpts.offset(number) for number, name in enumerate(names)}
    return ShapesRig(str(sculpts.write_folder(folder / "rig", **offsets)))


def meshes(**weights: np.ndarray) -> np.ndarray:
    """Meshes `(frame, vertex, 3)` of the shapes that `rig_of` makes, in the order of their names there."""
    total = sum(weight[:, None, None] * sculpts.offset(number) for number, weight in enumerate(weights.values()))
    return sculpts.POINTS + total


def opened(path: Path, rig, **options) -> MeshSequence:
    return open_sequence(str(path), rig, ReadingOptions(**options))


def found(path: Path, rig, **options) -> np.ndarray:
    return opened(path, rig, **options).read(0, FRAMES)


@pytest.mark.parametrize(
    "how",
    [
        {"count_column": "BlendShapeCount"},
        {"count_column": "BlendshapeCount"},
        {"count_column": "blendShapeCount", "encoding": "utf-8-sig"},
        {"delimiter": ";", "comma": True},
        {"delimiter": ";"},
        {"delimiter": "\t", "encoding": "utf-16"},
        {"more": {"Device": ["iPhone"] * FRAMES, "FrameIndex": np.arange(FRAMES) * 2.0, "": np.arange(FRAMES) * 1.0}},
        {"more": {"Confidence": np.ones(FRAMES), "HeadPosX": np.linspace(-90, 40, FRAMES)}},
    ],
)
def test_takes_of_every_make_are_one_take(how, tmp_path):
    rig, weights = rig_of(tmp_path, "browDownLeft", "jawOpen"), curves(["browDownLeft", "jawOpen"], FRAMES)
    sequence = opened(write_take(tmp_path / "take.csv", weights, CODES, **how), rig)
    assert np.abs(sequence.read(0, FRAMES) - meshes(**weights)).max() < 1e-5
    assert sequence.fps == 30 and sequence.in_rig_space and sequence.facts.format == "Live Link Face CSV"
    said = " ".join(sequence.facts.notes)
    assert ("decimal comma" in said) == ("comma" in how)
    assert all(f"'{name}'" in said for name in how.get("more", {}) if name) and ("left out" in said) == ("more" in how)


def test_columns_in_any_order_and_case(tmp_path):
    rig, weights = rig_of(tmp_path, "browDownLeft", "jawOpen"), curves(["browDownLeft", "jawOpen"], FRAMES)
    lines = write_take(tmp_path / "take.csv", weights, CODES).read_text().splitlines()
    order = np.random.default_rng(1).permutation(len(lines[0].split(",")))
    table = [[line.split(",")[column] for column in order] for line in lines]
    for change in (str.lower, str.upper, lambda name: name.replace("Left", "_L").replace("Right", "_R")):
        rows = [",".join(map(change, table[0])), *(",".join(row) for row in table[1:])]
        (tmp_path / "other.csv").write_text("\r\n".join(rows))
        assert np.abs(found(tmp_path / "other.csv", rig) - meshes(**weights)).max() < 1e-5


@pytest.mark.parametrize(
    "halves", [("browInnerUp_L", "browInnerUp_R"), ("browInnerUpLeft", "browInnerUpRight"), ("L_BrowInnerUp", "R_BrowInnerUp")]
)
def test_one_shape_of_a_take_drives_both_halves(halves, tmp_path):
    weights = curves(["browInnerUp"], FRAMES)
    sequence = opened(write_take(tmp_path / "take.csv", weights, CODES), rig_of(tmp_path, *halves))
    both = dict.fromkeys(halves, weights["browInnerUp"])
    assert np.abs(sequence.read(0, FRAMES) - meshes(**both)).max() < 1e-5
    assert f"browInnerUp drives {halves[0]} and {halves[1]}" in sequence.facts.notes[0]


def test_a_merged_shape_is_driven_by_the_mean_of_its_halves(tmp_path):
    weights = curves(["mouthSmileLeft", "mouthSmileRight"], FRAMES)
    sequence = opened(write_take(tmp_path / "take.csv", weights, CODES), rig_of(tmp_path, "mouthSmile"))
    mean = (weights["mouthSmileLeft"] + weights["mouthSmileRight"]) / 2
    assert np.abs(sequence.read(0, FRAMES) - meshes(mouthSmile=mean)).max() < 1e-5
    assert "the mean of mouthSmileLeft and mouthSmileRight drives mouthSmile" in sequence.facts.notes[0]


def test_which_shapes_stand_for_arkits():
    ict = ["browInnerUp_L", "browInnerUp_R", "cheekPuff_L", "cheekPuff_R", "eyeBlink_L", "eyeBlink_R", "jawOpen", "browInnerUp"]
    parts = arkit_parts(ict)
    assert parts["cheekPuff"] == (("cheekPuff_L", "cheekPuff_R"), 1) and parts["browInnerUp"].names == ("browInnerUp",)
    assert parts["eyeBlinkLeft"].names == ("eyeBlink_L",)
    assert arkit_parts(["jaw", "mouth"]) == {}  # jawLeft and jawRight are two ways to go, not two halves
    assert arkit_parts(["mouthSmile", "mouthSmileLeft"]).keys() == {"mouthSmileLeft"}
    for name in ("EyeBlinkLeft", "eyeBlink.L", "rig:eyeBlink_l", "L_eyeBlink", "eyeBlinkL", "eye_blink_left", "Left EyeBlink"):
        assert plain_name(name) == "eyeblinkleft", name
    assert len({plain_name(name) for name in ARKIT_NAMES}) == 52


def test_a_shape_that_only_the_take_has(tmp_path):
    rig = rig_of(tmp_path, "jawOpen")
    resting = write_take(tmp_path / "rest.csv", curves(["jawOpen"], FRAMES), CODES)
    assert not opened(resting, rig).facts.notes  # what the rig lacks never moves
    weights = curves(["jawOpen", "tongueOut"], FRAMES)
    take = write_take(tmp_path / "take.csv", weights, CODES)
    for unknown in ("error", "ignore_missing"):
        with pytest.raises(InputError, match=r"TongueOut moves, but rig 'rig' has no ARKit shape.*reading.unknown=ignore_new"):
            opened(take, rig, unknown=unknown)
    for unknown in ("ignore_new", "ignore_both"):
        sequence = opened(take, rig, unknown=unknown)
        assert "left out: TongueOut" in sequence.facts.notes[0]
        assert np.abs(sequence.read(0, FRAMES) - meshes(jawOpen=weights["jawOpen"])).max() < 1e-5


def test_a_shape_that_only_the_rig_has(tmp_path):
    rig, weights = rig_of(tmp_path, "jawOpen", "tongueOut"), curves(["jawOpen"], FRAMES)
    take = write_take(tmp_path / "take.csv", weights, CODES, left_out=["tongueOut"])
    for unknown in ("error", "ignore_new"):
        with pytest.raises(InputError, match=r"1 of the 2 ARKit columns are missing.*TongueOut.*ignore_missing"):
            opened(take, rig, unknown=unknown)
    assert "stay at 0: TongueOut" in opened(take, rig, unknown="ignore_missing").facts.notes[0]
    assert np.abs(found(take, rig, unknown="ignore_both") - meshes(jawOpen=weights["jawOpen"])).max() < 1e-5
    with pytest.raises(InputError, match="reading.unknown is 'perhaps'"):
        ReadingOptions(unknown="perhaps")


def test_a_rig_that_has_no_arkit_shapes_is_told_what_it_may_take(tmp_path):
    take = write_take(tmp_path / "take.csv", curves(["jawOpen"], FRAMES), CODES)
    with pytest.raises(InputError, match=r"no ARKit shapes.*a clip of its mesh, or curves of its own controls"):
        opened(take, ToyRig())


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("0.5000000000", "nan", "line 2, column JawOpen: found 'nan'.*not a finite number"),
        ("0.5000000000", "-1.#IND", "line 2, column JawOpen.*not a finite number"),
        ("0.5000000000", "-nan(ind)", "line 2, column JawOpen.*not a finite number"),
        ("0.5000000000", "", "line 2, column JawOpen.*an empty cell"),
        ("0.5000000000", "5.0D-01", "line 2, column JawOpen.*a Fortran exponent"),
        ("0.5000000000", "1 000.5", "line 2, column JawOpen.*thousands separators"),
        ("0.5000000000", "50%", "line 2, column JawOpen.*per cent"),
        ("0.5000000000", "50.0", "jawOpen is 50 in row 1.*divide them by 100"),
        ("0.5000000000", "0,5", "line 2: 64 values, expected 63"),
        ("Timecode", "Time", "none of its columns"),
        ("JawOpen", "jawopen,JawOpen", "are one shape"),
        ("JawOpen", "TongueOut", "'TongueOut' is there twice"),
    ],
)
def test_what_cannot_be_meant_is_named(before, after, says, tmp_path):
    rig = rig_of(tmp_path, "jawOpen")
    take = write_take(tmp_path / "take.csv", {"jawOpen": np.full(FRAMES, 0.5)}, CODES)
    text = take.read_text().replace(before, after, 1)
    take.write_text(text if "jawopen," not in after else text.replace("0.5000000000", "0.5,0.5"))
    with pytest.raises(InputError, match=says):
        opened(take, rig)


def test_decimal_commas_in_a_file_of_commas_are_named(tmp_path):
    take = write_take(tmp_path / "take.csv", curves(["jawOpen"], FRAMES), CODES)
    head, *body = take.read_text().splitlines()
    take.write_text("\n".join([head, *(row.replace(".", ",") for row in body)]))
    with pytest.raises(InputError, match="line 2: .* are its decimals commas"):
        read_live_link(take)
    take.write_text("\n".join([head, *(",".join(f'"{cell.replace(".", ",")}"' for cell in row.split(",")) for row in body)]))
    assert "decimal comma" in read_live_link(take).facts.notes[0]  # in quotes they are no doubt


def test_weights_beyond_their_range_are_said(tmp_path):
    take = write_take(tmp_path / "take.csv", {"jawOpen": np.linspace(-0.2, 1.5, FRAMES)}, CODES)
    recording = read_live_link(take)
    assert "weights are beyond 0 to 1" in recording.facts.notes[0] and "jawOpen is 1.5" in recording.facts.notes[0]
    assert float(recording.weights.max()) == 1.5
    assert not read_live_link(write_take(tmp_path / "b.csv", {"jawOpen": np.full(FRAMES, 1.003)}, CODES)).facts.notes


def test_a_drop_frame_timecode_in_a_file_of_semicolons(tmp_path):
    codes = [timecode(22 + frame, 30, 60, False, ";") for frame in range(FRAMES)]
    recording = read_live_link(write_take(tmp_path / "take.csv", {}, codes, delimiter=";", comma=True))
    assert recording.fps == pytest.approx(30000 / 1001, rel=1e-3) and len(recording.weights) == FRAMES


def test_turns_of_the_head_are_left_out_and_said(tmp_path):
    rig, weights = rig_of(tmp_path, "jawOpen"), curves(["jawOpen"], FRAMES)
    take = write_take(tmp_path / "take.csv", weights, CODES, more={"HeadYaw": np.linspace(0, 1, FRAMES)})
    assert "head and eyes were left out" in opened(take, rig).facts.notes[0]
    assert np.abs(found(take, rig) - meshes(**weights)).max() < 1e-5


def test_rows_are_frames_at_their_own_numbers(tmp_path):
    rig = rig_of(tmp_path, "jawOpen")
    codes = [timecode(frame, 30, 60) for frame in (*range(6), *range(96, 102))]
    sequence = opened(write_take(tmp_path / "take.csv", curves(["jawOpen"], FRAMES), codes), rig)
    assert sequence.frame_numbers.tolist() == [*range(6), *range(96, 102)] and sequence.fps == 30


def test_a_command_says_how_a_take_was_read(run, tmp_path):
    rig_of(tmp_path, "browInnerUp_L", "browInnerUp_R")
    codes = [timecode(frame, 30, 60) for frame in (*range(6), *range(96, 102))]
    take = write_take(tmp_path / "take.csv", curves(["browInnerUp", "tongueOut"], FRAMES), codes)
    arguments = ("rig=shapes", f"rig.folder={tmp_path / 'rig'}", f"clip={take}", "look.page=false", "look.sheet=false")
    refused = run("invert", *arguments, "out=a")
    assert refused.code == 1 and "reading.unknown=ignore_new" in refused.text
    outcome = run("invert", *arguments, "out=b", "reading.unknown=ignore_new", "method=levenberg_marquardt")
    assert outcome.code == 0, outcome.text
    for said in (
        "rows are missing: 90",
        "browInnerUp drives browInnerUp_L and browInnerUp_R",
        "left out: TongueOut",
        "30 a second",
    ):
        assert said in " ".join(outcome.text.split())
    compared = run("compare", *arguments[:2], f"capture={take}", "reading.unknown=ignore_new", "methods=[neutral]", "poses=4")
    assert compared.code == 0 and "browInnerUp drives" in compared.text, compared.text


def test_an_npz_of_meshes_is_still_one(tmp_path):
    toy = ToyRig()
    sequence = opened(write_npz(tmp_path / "a.npz", performance(toy), toy.faces.numpy()), toy)
    assert not sequence.in_rig_space and sequence.controls is None
