"""NumPy arrays as clips: what other programs save beside the vertices, and under which names."""

from pathlib import Path

import numpy as np
import pytest

from riginv.clips.open import open_sequence
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence
from riginv.clips.topology import check_topology
from riginv.errors import InputError
from tests.support.clips import performance
from tests.support.toys import ToyRig

RIG = ToyRig(detail=1)
MESHES = performance(RIG, 8)
FACES = RIG.faces.numpy()


def saved(path: Path, **arrays: object) -> MeshSequence:
    np.savez(path, **{"vertices": MESHES, **arrays})
    return open_sequence(str(path), RIG, ReadingOptions())


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8", ">f4", ">f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_floats_of_every_width_are_read(dtype, order, tmp_path):
    found = saved(tmp_path / "a.npz", vertices=np.array(MESHES, dtype, order=order)).read(0, 8)
    assert np.abs(found - MESHES).max() < (0.05 if dtype == "f2" else 1e-4)


@pytest.mark.parametrize("dtype", ["i2", "i4", "i8", "u1"])
def test_whole_numbers_are_refused_with_a_sentence(dtype, tmp_path):
    with pytest.raises(InputError, match=r"a.npz: the vertices are whole numbers \(u?int\d+\), expected floats: save them as"):
        saved(tmp_path / "a.npz", vertices=np.abs(MESHES).astype(dtype))
    np.save(tmp_path / "a.npy", np.abs(MESHES).astype(dtype))
    with pytest.raises(InputError, match="a.npy: the vertices are whole numbers"):
        open_sequence(str(tmp_path / "a.npy"), RIG, ReadingOptions())


@pytest.mark.parametrize("name", ["verts", "points", "positions", "anything", "my/own"])
def test_the_vertices_may_have_another_name(name, tmp_path):
    np.savez(tmp_path / "a.npz", **{name: MESHES, "faces": FACES, "betas": np.zeros(10), "uv": np.zeros((8, 42, 2))})
    sequence = open_sequence(str(tmp_path / "a.npz"), RIG, ReadingOptions())
    assert np.abs(sequence.read(0, 8) - MESHES).max() < 1e-4 and check_topology(sequence, RIG) == ""
    assert sequence.facts.meshes == (name.split("/")[-1],)
    assert bool(sequence.facts.notes) == (name in ("anything", "my/own"))


def test_a_rest_mesh_named_vertices_does_not_hide_the_frames(tmp_path):
    sequence = saved(tmp_path / "a.npz", vertices=MESHES[0], positions=MESHES)
    assert sequence.facts.meshes == ("positions",) and len(sequence) == 8
    sequence = saved(tmp_path / "b.npz", vertices=MESHES[0], posed=MESHES)
    assert sequence.facts.meshes == ("posed",) and "'posed' was taken" in sequence.facts.notes[0]
    with pytest.raises(InputError, match=r"vertices are float64 of shape \(42, 3\), expected floats \(frame, vertex, 3\)"):
        saved(tmp_path / "c.npz", vertices=MESHES[0])


RATES = [24, 24.0, np.float32(24), np.array([24]), np.array([[24.0]]), "24", "24.0 fps", " 24 Hz", b"24", np.array(["24"])]


@pytest.mark.parametrize("rate", RATES, ids=repr)
@pytest.mark.parametrize("name", ["fps", "frame_rate", "mocap_framerate"])
def test_the_rate_may_be_a_number_an_array_or_a_text(name, rate, tmp_path):
    sequence = saved(tmp_path / "a.npz", **{name: rate})
    assert sequence.fps == 24 and sequence.facts.rate_source == f"its array {name}" and not sequence.facts.notes


def test_a_rate_may_be_a_fraction(tmp_path):
    assert saved(tmp_path / "a.npz", fps="30000/1001").fps == pytest.approx(29.97003)
    assert saved(tmp_path / "a.npz", fps="24000 / 1001").fps == pytest.approx(23.976024)


@pytest.mark.parametrize("rate", [np.array([24, 25]), "film", "24/0", "24,5", 24j, np.array([None])], ids=repr)
def test_a_rate_that_is_none_is_refused(rate, tmp_path):
    with pytest.raises(InputError, match="a.npz.*(fps is .*, expected one number|Python objects)"):
        saved(tmp_path / "a.npz", fps=rate)


@pytest.mark.parametrize("name", ["times", "time", "timestamps"])
@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_times_tell_rate_and_frames(name, dtype, tmp_path):
    numbers = np.array([5, 6, 7, 10, 11, 12, 13, 14])
    sequence = saved(tmp_path / "a.npz", **{name: (numbers / 25).astype(dtype)})
    assert sequence.fps == 25 and sequence.frame_numbers.tolist() == numbers.tolist()
    assert sequence.facts.rate_source == f"its {name}" and "2 frames are missing" in sequence.facts.notes[0]
    nanoseconds = (1_700_000_000_000_000_000 + np.arange(8) * 1e9 / 60).astype(np.int64)
    sequence = saved(tmp_path / "b.npz", **{name: nanoseconds})
    assert sequence.fps == 60 and sequence.frame_numbers.tolist() == list(range(8))
    with pytest.raises(InputError, match=f"{name} are float32 of shape .7,., expected a number for each of 8 frames"):
        saved(tmp_path / "c.npz", **{name: np.zeros(7, np.float32)})


def test_a_rate_and_times_that_contradict_are_said(tmp_path):
    sequence = saved(tmp_path / "a.npz", fps=24.0, times=np.arange(8) / 30)
    assert sequence.fps == 24 and sequence.facts.notes == ("fps is 24, and its times give 30 frames a second: fps was taken.",)
    sequence = saved(tmp_path / "b.npz", fps=30.0, times=np.array([0, 1, 2, 3, 4, 5, 8, 9]) / 30)
    assert sequence.fps == 30 and sequence.frame_numbers.tolist() == [0, 1, 2, 3, 4, 5, 8, 9]


@pytest.mark.parametrize("dtype", ["i4", "u2", "f4", "f8"])
def test_frame_numbers_may_be_of_any_type_if_they_are_whole(dtype, tmp_path):
    numbers = np.array([1, 2, 3, 5, 8, 9, 10, 11])
    for shaped in (numbers, numbers[:, None]):
        sequence = saved(tmp_path / "a.npz", frame_numbers=shaped.astype(dtype), fps=24.0)
        assert sequence.frame_numbers.tolist() == numbers.tolist()
    for wrong in (numbers + 0.5, numbers[:7], numbers * 1e30, np.full(8, np.nan), np.array(["1"] * 8)):
        with pytest.raises(InputError, match="frame_numbers are .*expected a whole number for each of 8 frames"):
            saved(tmp_path / "a.npz", frame_numbers=wrong)
    with pytest.raises(InputError, match="do not rise"):
        saved(tmp_path / "a.npz", frame_numbers=numbers[::-1])


@pytest.mark.parametrize("name", ["faces", "triangles", "tris"])
def test_faces_are_compared_under_any_usual_name(name, tmp_path):
    assert check_topology(saved(tmp_path / "a.npz", **{name: FACES.astype(np.uint32)}), RIG) == ""
    with pytest.raises(InputError, match="edges of the clip are none of the rig's"):
        check_topology(saved(tmp_path / "a.npz", **{name: FACES[:, ::-1] ** 2 % 42}), RIG)
    with pytest.raises(InputError, match=f"{name} are float64 of shape"):
        saved(tmp_path / "a.npz", **{name: FACES.astype(float)})
