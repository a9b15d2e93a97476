"""Clips in files of every kind, generated: they come back in order and time, or are refused."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import trimesh

from riginv.clips.open import open_sequence
from riginv.clips.topology import check_topology
from riginv.clips.units import resolve_units
from riginv.errors import InputError
from tests.support.clips import performance, reading_options
from tests.support.ply_writer import FORMS, Written, faces, ply, vertices
from tests.support.toys import ToyRig

RIG = ToyRig(detail=1)
FACES = RIG.faces.numpy()
POSES = performance(RIG, 40)
RATES = (23.976023976, 24.0, 25.0, 29.97002997, 30.0, 48.0, 50.0, 59.94005994, 60.0, 120.0)
QUICK, MANY = 60, 3000


class Case(NamedTuple):
    """What a clip should say: meshes, the number of each frame, frames a second, and faces in the order of its vertices."""

    meshes: np.ndarray
    numbers: np.ndarray
    fps: float
    faces: np.ndarray


def case(random: np.random.Generator) -> tuple[Case, bool]:
    """A case, and whether its vertices are the rig's in another order."""
    count, start = int(random.integers(2, 12)), int(random.integers(0, 25))
    steps = np.where(random.random(count - 1) < 0.2, random.integers(2, 6, count - 1), 1)
    steps[0] = 1
    numbers = int(random.choice([-30, 0, 1, 1001, 86_400])) + np.concatenate([[0], np.cumsum(steps)])
    meshes, triangles = POSES[start : start + count] + random.normal(0, 0.01, 3), FACES
    scrambled = random.random() < 0.15
    if scrambled:
        order = random.permutation(meshes.shape[1])
        meshes, triangles = meshes[:, order], np.argsort(order)[FACES]
    return Case(meshes, numbers, float(random.choice(RATES)), triangles), scrambled


def arrays(folder: Path, made: Case, random: np.random.Generator) -> str:
    name = str(random.choice(["vertices", "verts", "positions", "anything"]))
    told = [{"fps": made.fps, "frame_numbers": made.numbers}, {"times": made.numbers / made.fps}]
    told += [{"fps": str(made.fps), "frame_numbers": made.numbers.astype(float)}]
    save = np.savez if random.random() < 0.5 else np.savez_compressed
    save(
        folder / "a.npz",
        **{name: made.meshes.astype(random.choice(["f4", "f8"])), "faces": made.faces},
        **told[random.integers(3)],
    )
    return str(folder / "a.npz")


def mdd(folder: Path, made: Case, random: np.random.Generator) -> str:
    order = str(random.choice([">", ">", "<"]))
    times = (made.numbers / made.fps).astype(f"{order}f4").tobytes()
    data = struct.pack(f"{order}2i", *made.meshes.shape[:2]) + times + made.meshes.astype(f"{order}f4").tobytes()
    (folder / "a.mdd").write_bytes(data + b"\0" * (int(random.integers(0, 3)) if order == ">" else 0))
    return str(folder / "a.mdd")


def names(made: Case, random: np.random.Generator, suffix: str) -> list[str]:
    before = str(random.choice(["f.", "head_", "shot 3 v02.", "2024-05-03 (a) ", "Köpfe_01_"]))
    after, width = str(random.choice(["", "", ".lod0", "_v2"])), int(random.choice([1, 4, 6]))
    return [f"{before}{'-' * bool(number < 0)}{abs(number):0{width}d}{after}{suffix}" for number in made.numbers]


def beside(folder: Path, random: np.random.Generator, suffix: str) -> None:
    """Files that are no frames."""
    for name in random.choice([f"neutral{suffix}", ".DS_Store", f"._f.1{suffix}", "notes.txt"], 2, replace=False):
        (folder / name).write_text("not a mesh")


def obj_files(folder: Path, made: Case, random: np.random.Generator) -> str:
    style = int(random.integers(4))
    for name, points in zip(names(made, random, ".obj"), made.meshes):
        if style == 0:
            text = trimesh.exchange.obj.export_obj(trimesh.Trimesh(points, made.faces, process=False), digits=6)
        else:
            form = ("{:.6f}", "{:.6e}", "{:.6E}")[style - 1]
            lines = ["v " + " ".join(form.format(value) for value in point) for point in points]
            text = "\n".join(
                ["# by hand", "o head", *lines, *("f " + " ".join(f"{c + 1}/1" for c in face) for face in made.faces)]
            )
            text = text.replace("E", "D") if style == 3 else text
        (folder / name).write_text(text + "\n", newline="\r\n" if random.random() < 0.3 else "\n")
    beside(folder, random, ".obj")
    return str(folder)


def ply_files(folder: Path, made: Case, random: np.random.Generator) -> str:
    form = str(random.choice(["ascii", "binary_little_endian", "binary_big_endian"]))
    kind = str(random.choice(["float", "double", "float32"]))
    edges = Written("edge", ("int a", "int b"), [(0, 1)] * 3)
    lists = Written("extra", ("list uchar short a",), [([1, 2],), ([],)])
    mixed = [edges, lists, None][random.integers(3)]
    for name, points in zip(names(made, random, ".ply"), made.meshes):
        properties = [f"{kind} {axis}" for axis in random.permutation(["x", "y", "z"])] + ["uchar red"]
        elements = [
            vertices(points, properties),
            faces(made.faces, (f"list uchar {random.choice(['int', 'uint'])} vertex_indices",)),
        ]
        elements = elements[::-1] if random.random() < 0.3 else elements
        elements.insert(int(random.integers(3)), mixed) if mixed else None
        (folder / name).write_bytes(ply(elements, form, str(random.choice(["\n", "\r\n"]))))
    beside(folder, random, ".ply")
    return str(folder)


WRITERS: dict[str, Callable[[Path, Case, np.random.Generator], str]] = {
    "arrays": arrays,
    "mdd": mdd,
    "obj": obj_files,
    "ply": ply_files,
}


def check(kind: str, folder: Path, random: np.random.Generator) -> None:
    """Raises AssertionError where a generated clip comes back as another."""
    made, scrambled = case(random)
    path = WRITERS[kind](folder, made, random)
    missing = "bridge" if kind in ("obj", "ply") else "error"
    try:
        sequence = open_sequence(path, RIG, reading_options(missing_frames=missing))
    except InputError as refusal:  # of a name in which a dash may be a sign
        assert "a dash precedes" in str(refusal) and made.numbers[-1] < 0
        return
    if scrambled and kind != "mdd":  # which has no faces to tell by
        with pytest.raises(InputError, match="edges of the clip"):
            check_topology(sequence, RIG)
        return
    check_topology(sequence, RIG)
    found, rows = sequence.read(0, len(sequence)), np.searchsorted(sequence.frame_numbers, made.numbers)
    assert sequence.frame_numbers[rows].tolist() == made.numbers.tolist(), (path, made.numbers, sequence.frame_numbers)
    assert np.abs(found[rows] - made.meshes).max() < 2e-4, path
    assert len(sequence) == len(made.numbers) or (missing == "bridge" and np.isnan(np.delete(found, rows, axis=0)).all())
    if kind in ("arrays", "mdd"):
        span = made.numbers[-1] - made.numbers[0]
        units = resolve_units(sequence, RIG, reading_options(unit="mm", up="y"))
        assert abs(span / units.fps - span / made.fps) < 1e-3 * span / made.fps + 1e-6, (path, units.fps, made.fps)


@pytest.mark.parametrize("kind", WRITERS)
def test_generated_clips_come_back(kind, tmp_path):
    assert set(FORMS) >= {"float", "double"}
    for number in range(QUICK):
        folder = tmp_path / str(number)
        folder.mkdir()
        check(kind, folder, np.random.default_rng((1, number)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRITERS)
def test_many_generated_clips_come_back(kind, tmp_path):
    for number in range(MANY):
        folder = tmp_path / str(number)
        folder.mkdir()
        check(kind, folder, np.random.default_rng((2, number)))
