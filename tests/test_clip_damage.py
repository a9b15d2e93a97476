"""Damaged clips of every format end in one sentence: real files with bytes changed, cut, doubled or left out, seeded."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from riginv.clips.clip import Clip
from riginv.clips.open import open_sequence
from riginv.clips.topology import check_topology
from riginv.clips.units import meaning_of
from riginv.errors import InputError
from tests.clips import (
    performance,
    write_animated_glb,
    write_mdd,
    write_npz,
    write_obj,
    write_pc2,
    write_usd,
)
from tests.toys import ToyRig

OPTIONS = {"mesh": None, "missing_frames": "error", "fps": None, "interpreter": None}
QUICK, MANY = 600, 5000  # damaged files of each format
IN_A_PROCESS = {"usda": 6, "usdc": 6}  # of these fewer: each file costs a process, a damaged one three


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig(detail=1, arkit=True)


def write_ply(path: Path, meshes: np.ndarray, faces: np.ndarray, encoding: str) -> Path:
    import trimesh

    mesh = trimesh.Trimesh(meshes[0], faces, process=False)
    path.write_bytes(trimesh.exchange.ply.export_ply(mesh, encoding=encoding))
    return path


def write_npy(path: Path, meshes: np.ndarray) -> Path:
    np.save(path, meshes.astype(np.float32))
    return path


def write_take(path: Path) -> Path:
    rows = [f"00:00:0{second}:00.000,61,{second / 10},0.5" for second in range(4)]
    path.write_text("\n".join(["Timecode,BlendShapeCount,JawOpen,MouthFunnel", *rows]) + "\n")
    return path


WRITERS: dict[str, Callable[[Path, np.ndarray, np.ndarray], Path]] = {
    "npz": write_npz,
    "packed.npz": lambda path, meshes, faces: write_npz(path, meshes, faces, compressed=True),
    "npy": lambda path, meshes, faces: write_npy(path, meshes),
    "obj": lambda path, meshes, faces: write_obj(path, meshes[0], faces),
    "ply": lambda path, meshes, faces: write_ply(path, meshes, faces, "binary"),
    "text.ply": lambda path, meshes, faces: write_ply(path, meshes, faces, "ascii"),
    "mdd": lambda path, meshes, faces: write_mdd(path, meshes),
    "pc2": lambda path, meshes, faces: write_pc2(path, meshes),
    "glb": write_animated_glb,
    "csv": lambda path, meshes, faces: write_take(path),
    "usda": write_usd,
    "usdc": write_usd,
}


def damaged(data: bytes, random: np.random.Generator) -> bytes:
    """Some harm of a kind that happens: flipped, cut, doubled, zeroed or random bytes, most often near the start."""
    content = bytearray(data)
    for _ in range(int(random.integers(1, 4))):
        size = len(content)
        place = int(min(random.exponential(120), size - 1)) if random.random() < 0.6 else int(random.integers(size))
        length = int(min(random.integers(1, 24), size - place))
        kind = random.integers(7)
        if kind == 0:
            content[place] ^= 1 << int(random.integers(8))
        elif kind == 1:
            del content[place:]
        elif kind == 2:
            content[place : place + length] = random.integers(0, 256, length, dtype=np.uint8).tobytes()
        elif kind == 3:
            content[place : place + length] = b"\0" * length
        elif kind == 4:
            content[place:place] = content[place : place + length]
        elif kind == 5:
            del content[place : place + length]
        else:
            content[place : place + length] = b"\xff" * length
        if not content:
            return b""
    return bytes(content)


def read_all(path: Path, rig: ToyRig) -> np.ndarray:
    """As the command does: opened, compared with the rig, measured, and read window by window."""
    sequence = open_sequence(str(path), rig, OPTIONS)
    check_topology(sequence, rig)
    clip = Clip(sequence, meaning_of(sequence, rig, "auto", 1.0, "auto", None))
    return np.concatenate([clip.vertices(start, min(start + 5, len(clip))).numpy() for start in range(0, len(clip), 5)])


def survive(kind: str, rig: ToyRig, folder: Path, cases: int, seed: int) -> tuple[int, int]:
    """How many damaged files ended in a sentence, and how many were read all the same."""
    if kind.startswith("usd"):
        pytest.importorskip("pxr", reason="usd-core is not installed")
    meshes = performance(rig, 7)
    whole = WRITERS[kind](folder / f"whole.{kind}", meshes, rig.faces.numpy())
    assert len(read_all(whole, rig)) in (1, 4, 7)
    data, refused = whole.read_bytes(), 0
    for case in range(cases):
        random = np.random.default_rng([seed, case])
        path = folder / f"case_{case}.{kind}"  # USD keeps layers by name
        path.write_bytes(damaged(data, random))
        try:
            found = read_all(path, rig)
        except InputError as error:
            assert path.name in str(error) or "reading." in str(error), f"case {case}: {error}"
            assert "\n" not in str(error), f"case {case}: {error}"
            refused += 1
        else:
            assert found.shape[1:] == meshes.shape[1:] and found.dtype == np.float32
        path.unlink()
    return refused, cases - refused


@pytest.mark.parametrize("kind", WRITERS)
def test_damaged_clips_end_in_a_sentence(kind, rig, tmp_path):
    refused, _ = survive(kind, rig, tmp_path, IN_A_PROCESS.get(kind, QUICK), seed=1)
    assert refused > 2  # the damage is real


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRITERS)
def test_many_more_damaged_clips_end_in_a_sentence(kind, rig, tmp_path):
    survive(kind, rig, tmp_path, 50 * IN_A_PROCESS[kind] if kind in IN_A_PROCESS else MANY, seed=2)


def test_a_header_that_promises_too_much_costs_nothing(rig, tmp_path):
    """Headers that ask for terabytes are refused by the size of the file."""
    meshes = performance(rig, 7)
    huge = np.array([2**31 - 1, 2**20], ">i4").tobytes()
    mdd = write_mdd(tmp_path / "a.mdd", meshes)
    mdd.write_bytes(huge + mdd.read_bytes()[8:])
    npy = write_npy(tmp_path / "a.npy", meshes)
    npy.write_bytes(npy.read_bytes().replace(b"(7, 42, 3)", b"(7, 4294967295, 3)".ljust(10), 1))
    for path in (mdd, npy):
        with pytest.raises(InputError, match=path.name):
            read_all(path, rig)


def test_arrays_of_python_objects_are_never_loaded(rig, tmp_path):
    np.save(tmp_path / "a.npy", np.array([[[print] * 3]], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="Python objects"):
        read_all(tmp_path / "a.npy", rig)


def test_a_folder_of_both_kinds_is_refused(rig, tmp_path):
    meshes = performance(rig, 2)
    write_obj(tmp_path / "a.1.obj", meshes[0], rig.faces.numpy())
    write_ply(tmp_path / "a.2.ply", meshes, rig.faces.numpy(), "binary")
    with pytest.raises(InputError, match="not both"):
        read_all(tmp_path, rig)
    shutil.rmtree(tmp_path)
