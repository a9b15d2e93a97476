"""Frames by their names: in the order that the program that wrote them meant, or refused with the pattern to type."""

import random
import shlex
from pathlib import Path

import numpy as np
import pytest

from riginv.clips.numbered import find_frames
from riginv.clips.open import open_sequence
from riginv.clips.options import ReadingOptions
from riginv.errors import InputError
from tests.support.clips import performance, write_obj
from tests.support.toys import ToyRig


def touch(folder: Path, *names: str) -> Path:
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).write_text("")
    return folder


def numbers(path: Path | str, **options) -> list[int]:
    return find_frames(str(path), ".obj", **options).numbers.tolist()


def names(path: Path | str) -> list[str]:
    return [file.name for file in find_frames(str(path), ".obj").paths]


@pytest.mark.parametrize(
    "frame",
    ["f.{}.obj", "f_{}.obj", "f{}.obj", "f-{}.obj", "{}.obj", "{}_head_v02.obj", "head.{}.lod0.obj", "2024-05-03 t1 {}.obj"],
)
@pytest.mark.parametrize("width", [1, 4])
def test_the_number_that_varies_is_the_frames(frame, width, tmp_path):
    folder = touch(tmp_path / "shot", *(frame.format(f"{number:0{width}d}") for number in (1, 2, 3, 9, 10, 11, 4, 5, 6, 7, 8)))
    assert numbers(folder) == numbers(folder / "*.obj") == list(range(1, 12))
    assert [int(name[len(frame.split("{")[0]) :].split(frame.split("}")[1])[0]) for name in names(folder)] == list(range(1, 12))


@pytest.mark.parametrize("other", ["neutral.obj", "rest_pose.OBJ", "neutral_01.obj", "f.final.obj", "f.0001 (1).obj"])
def test_a_file_that_is_no_frame_is_left_out_with_a_note(other, tmp_path):
    folder = touch(tmp_path / "shot", *(f"f.{number}.obj" for number in range(1, 25)), other)
    for path in (folder, folder / "*.obj"):
        found = find_frames(str(path), ".obj")
        if other.endswith(".OBJ") and path != folder:
            continue  # which the pattern does not name
        assert found.numbers.tolist() == list(range(1, 25))
        assert len(found.notes) == 1 and f"Left out: {other}, not of the sequence" in found.notes[0]
    assert not find_frames(str(folder / "f.%d.obj"), ".obj").notes


@pytest.mark.parametrize("frame", ["f.{}.obj", "f.{}.lod0.obj", "head_{}.obj", "v2_{}.obj", "f--{}.obj"])
@pytest.mark.parametrize("width", [1, 4])
def test_negative_frames_play_in_order(frame, width, tmp_path):
    frame = frame.replace("--", "-")
    written = {number: f"{'-' if number < 0 else ''}{abs(number):0{width}d}" for number in range(-3, 4)}
    folder = touch(tmp_path / "shot", *(frame.format(text) for text in written.values()))
    pattern = folder / frame.format("%d")
    assert numbers(folder) == numbers(pattern) == [-3, -2, -1, 0, 1, 2, 3]
    assert names(folder)[0] == frame.format(written[-3])


def test_a_dash_is_no_sign_where_it_only_parts_the_number(tmp_path):
    folder = touch(tmp_path / "a", "f-1.obj", "f-2.obj", "f-3.obj")
    found = find_frames(str(folder), ".obj")
    assert found.numbers.tolist() == [1, 2, 3] and f"not a minus ({folder}/f%d.obj: a minus)" in found.notes[0]
    assert numbers(folder / "f%d.obj") == [-3, -2, -1]
    assert numbers(touch(tmp_path / "b", "take 1-7-1.obj", "take 1-7-2.obj")) == [1, 2]
    assert numbers(touch(tmp_path / "c", "f-2.obj", "f-1.obj", "f0.obj", "f1.obj")) == [-2, -1, 0, 1]


def test_a_dash_behind_a_space_may_be_either_and_is_asked_about(tmp_path):
    folder = touch(tmp_path / "shot", "take -0003.obj", "take -0002.obj", "take -0001.obj")
    with pytest.raises(InputError, match=r"dash precedes .*/take -%04d.obj' where it is part of .*/take %04d.obj' where it is"):
        numbers(folder)
    assert numbers(folder / "take -%04d.obj") == [1, 2, 3] and numbers(folder / "take %04d.obj") == [-3, -2, -1]
    touch(folder, "take 0000.obj")
    assert numbers(folder) == [-3, -2, -1, 0]


@pytest.mark.parametrize(
    "pattern", ["head.%04d.lod0.obj", "head.%d.lod0.obj", "head.####.lod0.obj", "head.$F4.lod0.obj", "head.<frame>.lod0.obj"]
)
def test_the_frame_is_where_the_pattern_says(pattern, tmp_path):
    files = [f"head.{number}.lod{level}.obj" for number in range(1001, 1007) for level in (0, 1)]
    folder = touch(tmp_path / "shot", *files, "head.neutral.lod0.obj", "body.1001.lod0.obj")
    assert numbers(folder / pattern) == list(range(1001, 1007))
    assert set(names(folder / pattern)) == {f"head.{number}.lod0.obj" for number in range(1001, 1007)}


def test_anything_may_stand_beside_the_frame_of_a_pattern(tmp_path):
    folder = touch(tmp_path / "shot", "head_0001_1001.obj", "head_0002_1002.obj", "x_0003_1003.obj")
    with pytest.raises(InputError, match=r"2 numbers vary .*head_%04d_\*\.obj.* or .*head_\*_%d\.obj"):
        numbers(folder / "head*.obj")
    assert numbers(folder / "head_%04d_*.obj") == [1, 2] and numbers(folder / "*_*_%d.obj") == [1001, 1002, 1003]


@pytest.mark.parametrize(
    "files, patterns",
    [
        (["a.0001.obj", "a.0002.obj", "b.0001.obj", "b.0002.obj"], ["a.%04d.obj", "b.%04d.obj"]),
        (["f.1.obj", "f.2.obj", "f.1.50.obj", "f.2.50.obj"], ["f.%d.obj", "f.%d.50.obj"]),  # sub-frames
        (["f.1.00.obj", "f.1.50.obj", "f.2.00.obj", "f.2.50.obj", "f.3.00.obj", "f.3.50.obj"], ["f.%d.00.obj", "f.%d.50.obj"]),
        (["h_v1.1.obj", "h_v1.2.obj", "h_v1.3.obj", "h_v2.1.obj", "h_v2.2.obj", "h_v2.3.obj"], ["h_v1.%d.obj", "h_v2.%d.obj"]),
    ],
)
def test_several_sequences_are_refused_with_a_pattern_for_each(files, patterns, tmp_path):
    folder = touch(tmp_path / "my shot", *files)
    for given in (folder, folder / "*.obj"):
        with pytest.raises(InputError) as refusal:
            numbers(given)
        for pattern in patterns:
            typed = shlex.quote(str(folder / pattern))
            assert typed in str(refusal.value), refusal.value
            assert len(numbers(shlex.split(typed)[0])) == len(files) // 2  # as typed, it works


@pytest.mark.parametrize(
    "files",
    [["f.1.obj", "neutral.obj"], ["f.1.obj", "f.2.obj", "smile.obj", "frown.obj"], ["1_ab.obj", "2_cd.obj", "3_ef.obj"]],
)
def test_what_may_be_frames_or_not_is_asked_for(files, tmp_path):
    with pytest.raises(InputError, match="which are the frames.*give the pattern"):
        numbers(touch(tmp_path / "shot", *files))


def test_names_without_numbers_are_read_by_name_and_said_so(tmp_path):
    found = find_frames(str(touch(tmp_path / "shot", "smile.obj", "frown.obj")), ".obj")
    assert [file.stem for file in found.paths] == ["frown", "smile"] and "order of their names" in found.notes[0]


def test_hidden_files_and_those_of_systems_are_passed_over(tmp_path):
    files = [f"f.{number}.obj" for number in (1, 2, 3)]
    folder = touch(
        tmp_path / "shot", *files, *(f"._{name}" for name in files), ".DS_Store", "Thumbs.db", "desktop.ini", ".f.4.obj"
    )
    (folder / "f.9.obj").mkdir()  # no file
    for pattern in ("", "*.obj", "*.1.obj", "f.*.obj", "f.%d.obj", "?.#.obj"):
        assert numbers(folder / pattern) == ([1] if pattern == "*.1.obj" else [1, 2, 3])
    rig = ToyRig()
    write_obj(folder / "f.1.obj", performance(rig, 1)[0], rig.faces.numpy())
    (folder / "._f.1.ply").write_text("")  # of another suffix, and hidden
    assert open_sequence(str(folder), rig, ReadingOptions()).frame_numbers.tolist() == [1, 2, 3]


def test_padding_may_change_but_frames_stand_once(tmp_path):
    folder = touch(tmp_path / "shot", "f.8.obj", "f.09.obj", "f.010.obj", "f.11.obj")
    assert numbers(folder) == numbers(folder / "f.%04d.obj") == [8, 9, 10, 11]
    touch(folder, "f.9.obj")
    with pytest.raises(InputError, match=r"f.09.obj and f.9.obj are the same frame"):
        numbers(folder)


def test_gaps_are_named_as_spans_and_long_ones_refused(tmp_path):
    folder = touch(tmp_path / "shot", *(f"f.{number}.obj" for number in (1, 2, 3, 7, 9, 10, 1001, 1002)))
    with pytest.raises(InputError, match="994 of frames 1 to 1002 are missing: 4 to 6, 8, 11 to 1000; add them"):
        numbers(folder)
    bridged = find_frames(str(folder), ".obj", bridge=True)
    assert len(bridged.numbers) == 1002 and sum(path is None for path in bridged.paths) == 994
    assert bridged.notes == ("994 frames have no file and are interpolated (reading.missing_frames=error refuses them).",)
    every_second = find_frames(str(touch(tmp_path / "b", "f.1.obj", "f.3.obj", "f.5.obj")), ".obj")
    assert every_second.numbers.tolist() == [1, 3, 5] and "every 2 frames" in every_second.notes[0]
    touch(folder, "f.20260101000000.obj")
    with pytest.raises(InputError, match="rename them in order"):
        numbers(folder, bridge=True)
    touch(folder, "f.99999999999999999999.obj")
    with pytest.raises(InputError, match="beyond 2"):
        numbers(folder)


def test_a_link_to_nothing_is_a_frame_that_is_missed(tmp_path):
    folder = touch(tmp_path / "shot", "f.1.obj", "f.3.obj")
    (folder / "f.2.obj").symlink_to(tmp_path / "nowhere.obj")
    rig = ToyRig()
    for number in (1, 3):
        write_obj(folder / f"f.{number}.obj", performance(rig, 1)[0], rig.faces.numpy())
    with pytest.raises(InputError, match="f.2.obj: no such file"):
        open_sequence(str(folder), rig, ReadingOptions()).read(0, 3)


def test_one_file_of_a_sequence_says_so(tmp_path):
    folder = touch(tmp_path / "shot", *(f"head.{number}.lod0.obj" for number in (1001, 1002, 1003)), "neutral.obj")
    found = find_frames(str(folder / "head.1002.lod0.obj"), ".obj")
    assert found.numbers.tolist() == [1002] and "2 more files" in found.notes[0] and "head.%d.lod0.obj" in found.notes[0]
    assert not find_frames(str(folder / "neutral.obj"), ".obj").notes


@pytest.mark.parametrize("name", ["take #1.obj", "100%d.obj", "[a] 1.obj", "<frame>.obj", "a*b.obj"])
def test_a_file_of_that_very_name_is_that_file(name, tmp_path):
    folder = touch(tmp_path / "shot", name, "take 21.obj", "a 1.obj")
    assert names(folder / name) == [name]


def test_brackets_in_a_pattern_stand_for_themselves_where_nothing_else_fits(tmp_path):
    folder = touch(tmp_path / "[x] shots", "[a] f.1.obj", "[a] f.2.obj")
    assert numbers(folder / "[a] f.*.obj") == numbers(folder / "[a] f.%d.obj") == [1, 2]
    assert numbers(touch(tmp_path / "b", "af.1.obj", "bf.2.obj") / "[ab]f.1.obj") == [1]


@pytest.mark.parametrize("missing", ["none/f.%d.obj", "none/*.obj", "shot/g.%d.obj", "shot/*.x.obj", "shot/g.obj"])
def test_what_is_not_there_is_said(missing, tmp_path):
    touch(tmp_path / "shot", "f.1.obj")
    with pytest.raises(
        InputError, match="no frames: expected .*found none" + ("" if missing[0] == "s" else ".*there is no folder")
    ):
        numbers(tmp_path / missing)


def test_generated_names_come_back_in_order_or_are_refused(tmp_path):
    """Any names around the frames, any padding, start and step, with files of no frame and hidden ones beside them."""
    draw = random.Random(7)
    words = ["head", "Take 3", "v02", "lod0", "s01e02", "2024-05-03", "ärger", "頭", "x", "cam1.L", "[a]", "it's"]
    refused = 0
    for case in range(300):
        before, after = ("".join(draw.choice(words) + draw.choice("._- ") for _ in range(draw.randint(0, 2))) for _ in "12")
        before, after = before.lstrip("-. "), "." + after.rstrip(". ") if after else ""
        first, step, count, width = (
            draw.randint(-20, 1100),
            draw.choice((1, 1, 2, 5)),
            draw.randint(2, 9),
            draw.choice((1, 3, 4)),
        )
        frames = [first + step * number for number in range(count)]
        if before.endswith(("-", " ")) or not before:
            frames = [abs(frames[0]) + step * number for number in range(count)]
        files = [f"{before}{'-' if frame < 0 else ''}{abs(frame):0{width}d}{after}.obj" for frame in frames]
        folder = touch(tmp_path / str(case), *files, *draw.sample(["neutral.obj", "._x.obj", "notes.txt"], draw.randint(0, 2)))
        try:
            found = find_frames(str(folder), ".obj")
        except InputError:
            refused += 1
            continue
        assert found.numbers.tolist() == frames and [path.name for path in found.paths] == files, files
    assert not refused


def test_meshes_come_in_the_order_of_their_frames(tmp_path):
    rig = ToyRig()
    meshes = performance(rig, 12)
    for number, points in enumerate(meshes):
        write_obj(tmp_path / f"head_v02.{number - 5}.lod1.obj", points, rig.faces.numpy())
    write_obj(tmp_path / "neutral.obj", meshes[0] * 0, rig.faces.numpy())
    sequence = open_sequence(str(tmp_path), rig, ReadingOptions())
    assert sequence.frame_numbers.tolist() == list(range(-5, 7)) and sequence.facts.format == "OBJ"
    assert np.abs(sequence.read(0, 12) - meshes).max() < 1e-4 and "neutral.obj" in sequence.facts.notes[0]
