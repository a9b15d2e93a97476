"""python -m riginv.inspect as users type it: what a file holds, with a rig and without."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from riginv.launch.command import path_as_value
from riginv.rig.arkit import LIVE_LINK_SHAPES as SHAPES
from tests.conftest import ROOT
from tests.support.clips import obj_sequence, performance, write_animated_glb, write_npz, write_usd
from tests.support.markers import write_c3d, write_motive, write_trc
from tests.support.toys import ToyRig

TOY = ("rig=toy", f"--config-dir={ROOT / 'tests/conf'}")


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig()


@pytest.fixture(scope="module")
def meshes(rig) -> np.ndarray:
    return performance(rig, 20)


def table(text: str) -> dict[str, str]:
    """The rows of what was printed."""
    found = (line.strip().partition("  ") for line in text.splitlines() if line.startswith("  "))
    return {name: value.strip() for name, _, value in found}


def in_a_shell(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-m", "riginv.inspect", *arguments], cwd=folder, capture_output=True, text=True, env=environment
    )


def test_a_path_alone_is_enough_in_a_shell(rig, meshes, tmp_path):
    name = "take (1) [b], 'c'=頭.npz"
    write_npz(tmp_path / name, meshes, rig.faces.numpy())
    done = in_a_shell(tmp_path, name)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{name}\n")
    found = table(done.stdout)
    assert found["frames"] == "20 frames 0 to 19" and found["rate"] == "24 frames a second (its array fps)"
    assert found["unit"] == "not known" and found["vertices"] == "162, 320 faces"


@pytest.mark.parametrize("name", ["2024_05.npz", "Größe 頭.npz", "a=b.npz", "{x}.npz", 'quo"ted.npz', "#1,2.npz"])
def test_any_name_of_a_file_is_a_path(name, run: Callable, rig, meshes, tmp_path):
    write_npz(tmp_path / name, meshes, rig.faces.numpy())
    outcome = run("inspect", name)
    assert outcome.code == 0 and outcome.text.startswith(f"{name}\n"), outcome.text


def test_key_and_path_mean_the_same(run: Callable, rig, meshes, tmp_path):
    write_npz(tmp_path / "take.npz", meshes, rig.faces.numpy())
    alone = run("inspect", "take.npz")
    assert alone.code == 0 and alone.text == run("inspect", "clip=take.npz").text
    assert path_as_value(["rig=toy", "take.npz", "~seed", "+rig.x=1"], "clip") == [
        "rig=toy",
        'clip="take.npz"',
        "~seed",
        "+rig.x=1",
    ]
    assert path_as_value(["take.npz"], None) == ["take.npz"]
    done = run("inspect", "take.npz", "take.1.obj", "take.2.obj")  # as a shell expands take.*
    assert done.code == 1 and "3 paths were given (take.npz, take.1.obj and 1 more), expected one" in done.text


@pytest.mark.parametrize("kind", ["obj", "glb", "usd"])
def test_files_say_what_they_hold(kind, run: Callable, rig, meshes, tmp_path):
    faces = rig.faces.numpy()
    if kind == "obj":
        path = obj_sequence(tmp_path / "shot", meshes, faces)
    elif kind == "glb":
        path = write_animated_glb(tmp_path / "take.glb", meshes, faces)
    else:
        pytest.importorskip("pxr", reason="usd-core is not installed")
        path = write_usd(tmp_path / "take.usda", meshes, faces)
    outcome = run("inspect", str(path))
    assert outcome.code == 0, outcome.text
    found = table(outcome.text)
    first = 1001 if kind == "obj" else 0 if kind == "glb" else 1
    assert found["frames"] == f"20 frames {first} to {first + 19}"
    assert found["unit"].split()[0] == {"obj": "not", "glb": "m", "usd": "cm"}[kind]
    assert found["up"].split()[0] == ("z" if kind == "usd" else "y")
    assert run("inspect", str(path), *TOY).text.splitlines()[-1] == "the clip fits rig 'toy'"


def test_a_clip_that_does_not_fit_is_shown_and_refused(run: Callable, rig, meshes, tmp_path):
    write_npz(tmp_path / "other.npz", meshes[:, :100], np.array([[0, 1, 2]]))
    outcome = run("inspect", "other.npz", *TOY)
    assert outcome.code == 1 and table(outcome.text)["vertices"] == "100, 1 faces"
    assert "rig toy: 7 controls, 162 vertices" in outcome.text and "100 vertices and 1 faces, rig 'toy' has 162" in outcome.text


def test_options_of_reading_and_frames_count(run: Callable, rig, meshes, tmp_path):
    write_npz(tmp_path / "take.npz", meshes / 10, rig.faces.numpy())
    options = ("reading.unit=cm", "reading.up=z", "reading.fps=50", "frames.first=5", "frames.exclude=[7]")
    found = table(run("inspect", "take.npz", *options).text)
    assert found["frames"] == "15 frames 5 to 19 of 0 to 19 (1 excluded)" and found["rate"] == "50 frames a second (as given)"
    assert found["unit"] == "cm (as given)" and found["up"] == "z (as given)" and "m/s" in found["motion"]


def test_a_recording_says_which_shapes_move(run: Callable, tmp_path):
    columns = [name[0].upper() + name[1:] for name in SHAPES]
    weights = np.zeros((30, len(columns)))
    weights[:, columns.index("JawOpen")] = np.linspace(0, 0.8, 30)
    weights[:, columns.index("CheekPuff")] = 0.3
    lines = [",".join(["Timecode", "BlendShapeCount", *columns])]
    lines += [
        f"01:00:00:{2 * row:02d}.000,61," + ",".join(f"{value:.6f}" for value in values) for row, values in enumerate(weights)
    ]
    (tmp_path / "take.csv").write_text("\n".join(lines) + "\n")
    outcome = run("inspect", "take.csv")
    assert outcome.code == 0, outcome.text
    found = table(outcome.text)
    assert found["rows"] == "30" and found["rate"] == "30 frames a second" and found["columns"] == "52 shapes"
    assert found["shapes that move"] == "1: jawOpen (0 to 0.8)"
    assert found["shapes that do not"].startswith("51: ") and found["shapes that do not"].endswith(
        "more (verbose=true names all)"
    )
    assert "cheekPuff" in run("inspect", "take.csv", "verbose=true").text


def test_curves_of_controls_say_so(run: Callable, rig, tmp_path):
    """What `invert` writes was taken for a damaged Live Link Face recording."""
    values = np.zeros((4, len(rig.controls)))
    values[:, 0] = np.linspace(0, 0.75, 4)
    header = ",".join(["frame", "seconds", *rig.control_names])
    rows = [f"{number},{number / 24:.6f}," + ",".join(map(str, row)) for number, row in enumerate(values)]
    (tmp_path / "curves.csv").write_text("\n".join([header, *rows]) + "\n")
    (tmp_path / "curves.json").write_text('{"rig": "toy", "fps": 24.0}')
    outcome = run("inspect", "curves.csv")
    assert outcome.code == 0, outcome.text
    found = table(outcome.text)
    assert found["format"] == "CSV of curves: controls of a rig, without meshes" and found["rig"] == "toy"
    assert found["frames"] == "4 frames 0 to 3" and found["rate"] == "24 frames a second (curves.json)"
    assert found["controls"] == "7" and found["controls that move"] == f"1: {rig.control_names[0]} (0 to 0.75)"
    assert found["rigid motion"] == "none"
    (tmp_path / "found").mkdir()
    (tmp_path / "curves.csv").rename(tmp_path / "found/curves.csv")
    folder = table(run("inspect", "found").text)  # of invert's results
    assert folder["rig"] == "not stated" and folder["controls that move"] == found["controls that move"]
    (tmp_path / "curves.csv").write_text("\n".join([header, *rows, rows[0].replace("0.0", "much", 1)]) + "\n")
    outcome = run("inspect", "curves.csv")
    assert outcome.code == 1 and "line 6" in outcome.text and "Traceback" not in outcome.text, outcome.text
    np.savez(tmp_path / "curves.npz", controls=values, fps=24.0)
    outcome = run("inspect", "curves.npz")
    assert outcome.code == 0 and "7, without names" in outcome.text and "control 1 (0 to 0.75)" in outcome.text


def test_a_skeleton_alone_is_told(run: Callable, tmp_path):
    root = "ROOT hips\n{\nOFFSET 0 90 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n"
    head = "JOINT head\n{\nOFFSET 0 60 5\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 0 10 0\n}\n}\n}\n"
    motion = "MOTION\nFrames: 2\nFrame Time: 0.04\n0 90 0 0 0 0 0 0 0\n7 90 0 0 0 0 0 0 20\n"
    (tmp_path / "take.bvh").write_text(f"HIERARCHY\n{root}{head}{motion}")
    outcome = run("inspect", "take.bvh")
    assert outcome.code == 0, outcome.text
    found = table(outcome.text)
    assert found["joints"] == "2: hips, head" and found["frames"] == "2 frames 0 to 1" and found["rate"].startswith("25 frames")
    assert found["size"] == "0 x 60 x 5 units, of the joints at rest" and found["root"] == "moves over 7 x 0 x 0 units"
    refused = run("invert", "clip=take.bvh", "out=x", *TOY)
    assert refused.code == 1 and "Traceback" not in refused.text, refused.text


@pytest.mark.parametrize("name", ["take.c3d", "take.trc", "take.csv"])
def test_markers_are_named_with_their_gaps(name, run: Callable, tmp_path):
    points = np.random.default_rng(0).uniform(-100, 100, (4, 2, 3))
    points[1:3, 1] = np.nan
    write = {"take.c3d": write_c3d, "take.trc": write_trc, "take.csv": write_motive}[name]
    write(tmp_path / name, ["nose", "chin"], points, 24.0)
    outcome = run("inspect", name)
    assert outcome.code == 0 and "24 frames a second" in outcome.text and "chin (50%)" in outcome.text, outcome.text
    assert "4 frames" in outcome.text and "2: " in outcome.text and "1 mm" in outcome.text
    done = run("inspect", f"gone{name}")
    assert done.code == 1 and "no such file" in done.text


def test_bundles_and_stores_of_poses_are_told(run: Callable, tmp_path):
    assert run("train").code == 0
    found = table(run("inspect", "run").text)
    assert found["bundle"] == "inverse: meshes to controls" and found["rig"].startswith("toy, 162 vertices")
    assert found["controls"].startswith("7: bump0") and "steps 12" in found["training"]
    sampled = run("sample", *TOY, "samples=64", "chunk=32", "jobs=1", "out=poses.zarr")
    assert sampled.code == 0, sampled.text
    stored = run("inspect", "poses.zarr")
    assert stored.code == 0 and "64 of rig 'toy'" in stored.text


def test_the_meshes_of_a_stage_are_listed_where_it_is_not_clear_which_is_meant(run: Callable, rig, meshes, tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Sdf, Usd

    path = write_usd(tmp_path / "take.usda", meshes, rig.faces.numpy())
    stage = Usd.Stage.Open(str(path))
    (prim,) = [prim.GetPath() for prim in stage.Traverse() if prim.GetTypeName() == "Mesh"]
    Sdf.CopySpec(stage.GetRootLayer(), prim, stage.GetRootLayer(), prim.GetParentPath().AppendChild("Twin"))
    stage.Save()
    outcome = run("inspect", "take.usda")
    assert outcome.code == 0, outcome.text
    found = table(outcome.text)
    assert found["meshes"] == "2, of which 2 move" and found[str(prim)] == "162 vertices, 20 frames"
    assert "reading.mesh=NAME reads one of them" in outcome.text
    assert run("inspect", "take.usda", "reading.mesh=Twin").code == 0
    unclear = run("inspect", "take.usda", *TOY)  # both fit the rig
    assert unclear.code == 1 and "choose with reading.mesh=NAME" in unclear.text and table(unclear.text)["meshes"], unclear.text
    assert unclear.text.count("2, of which 2 move") == 1


def test_invert_opens_a_stage_once(run: Callable, rig, meshes, tmp_path, monkeypatch):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from rigs.usd.clip import UsdClip

    opened, begin = [], UsdClip.__init__
    monkeypatch.setattr(
        UsdClip, "__init__", lambda self, *given, **more: (opened.append(given), begin(self, *given, **more))[1]
    )
    write_usd(tmp_path / "take.usda", meshes[:3], rig.faces.numpy())
    done = run("invert", "clip=take.usda", "out=found", "look.page=false", "look.sheet=false", *TOY)
    assert done.code == 0 and len(opened) == 1, done.text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "clip must be given"),
        (["none.npz"], "none.npz: no such file"),
        (["notes.txt"], "clips end in"),
        (["hero.blend"], "hero.blend: a rig, and no clip: rig=blender rig.file=hero.blend"),
        (["hero.dna"], "rig=dna rig.file=hero.dna"),
        (["broken.npz"], "broken.npz: no .npz, or a damaged one"),
        (["empty"], "expected to hold OBJ or PLY files"),
        (["take.csv"], "expected the columns of a Live Link Face recording"),
        (["take.npz", "reading.unit=ell"], "reading.unit is 'ell'"),
        (["take.npz", "reading.fps=-1"], "reading.fps is -1"),
        (["take.npz", "frames.first=99"], "none left"),
        (["take.npz", "rig=fase"], "did you mean face"),
        (["take.npz", "bundle=nowhere"], "nowhere: no bundle there"),
        (["take.npz", "bundle=1"], "1: no bundle there"),
        (["x" * 300], "File name too long"),
        (["take.npz", "verbose=loud"], "verbose is 'loud'"),
        (["take.npz", "raeding.fps=3"], "did you mean reading.fps"),
    ],
)
def test_mistakes_end_in_one_sentence(arguments, said, run: Callable, rig, meshes, tmp_path):
    write_npz(tmp_path / "take.npz", meshes, rig.faces.numpy())
    (tmp_path / "notes.txt").write_text("no clip")
    (tmp_path / "broken.npz").write_bytes(b"PK\3\4" + bytes(40))
    (tmp_path / "take.csv").write_text("a,b\n1,2\n")
    (tmp_path / "empty").mkdir()
    before = set(tmp_path.iterdir())
    outcome = run("inspect", *arguments)
    assert outcome.code == 1 and said in outcome.text and "Traceback" not in outcome.text, outcome.text
    assert set(tmp_path.iterdir()) == before


def test_a_plain_table_of_markers_is_one(run, tmp_path):
    (tmp_path / "take.csv").write_text("frame,time,nose.x,nose.y,nose.z\n0,0,1,2,3\n1,0.1,-,-,-\n")
    taken = run("invert", "clip=take.csv", "out=x", *TOY)
    assert taken.code == 1 and "take.csv: markers, which riginv.invert takes with correspondence=markers" in taken.text
    done = run("inspect", str(tmp_path / "take.csv"))
    assert done.code == 0 and table(done.text)["markers"] == "1: nose" and table(done.text)["gaps"] == "1 marker: nose (50%)"
    assert "Taken as gaps: 3 cells of '-'." in done.text
