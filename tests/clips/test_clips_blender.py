"""Alembic and FBX, written by Blender and read through it; skipped where there is no Blender."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from riginv.clips.clip import Clip
from riginv.clips.open import open_sequence
from riginv.clips.topology import check_topology
from riginv.clips.units import resolve_units
from riginv.errors import InputError
from tests.support.blends import blender
from tests.support.clips import performance, reading_options
from tests.support.toys import ToyRig

OPTIONS = reading_options(fps=25.0)
FRAMES = 6
MAKE = """
import os, sys, bpy, numpy as np
data = np.load(sys.argv[-1])
folder = os.path.dirname(sys.argv[-1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps, scene.frame_start, scene.frame_end = 25, 1, len(data["vertices"])
z_up = np.stack([data["vertices"][..., 0], -data["vertices"][..., 2], data["vertices"][..., 1]], axis=2) / 10
mesh = bpy.data.meshes.new("head")
mesh.from_pydata(z_up[0].tolist(), [], data["faces"].tolist())
head = bpy.data.objects.new("head", mesh)
scene.collection.objects.link(head)
head.shape_key_add(name="Basis")
for number, points in enumerate(z_up):
    key = head.shape_key_add(name=f"frame {number}", from_mix=False)
    key.data.foreach_set("co", points.astype(np.float32).ravel())
    for frame in range(len(z_up)):
        key.value = float(frame == number)
        key.keyframe_insert("value", frame=frame + 1)
bpy.ops.wm.alembic_export(filepath=folder + "/head.abc", start=1, end=len(z_up), as_background_job=False)
bpy.ops.export_scene.fbx(
    filepath=folder + "/head.fbx", object_types={"MESH"}, bake_anim_simplify_factor=0.0,
    bake_anim_use_nla_strips=False, bake_anim_use_all_actions=False,
)
os._exit(0)
"""


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    """A folder with head.abc and head.fbx, in centimetres."""
    folder, rig = tmp_path_factory.mktemp("blender"), ToyRig()
    np.savez(folder / "meshes.npz", vertices=performance(rig, FRAMES), faces=rig.faces.numpy())
    (folder / "make.py").write_text(MAKE)
    command = [blender(), str(folder / "make.py"), str(folder / "meshes.npz")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize("name", ["head.abc", "head.fbx"])
def test_what_blender_writes_is_read(name, written):
    rig = ToyRig()
    sequence = open_sequence(str(written / name), rig, OPTIONS)
    assert not check_topology(sequence, rig)
    clip = Clip(sequence, resolve_units(sequence, rig, OPTIONS))
    assert len(clip) == FRAMES and clip.units.mm == 10
    expected = performance(rig, FRAMES)
    for start, stop in ((0, FRAMES), (2, 4), (FRAMES - 1, FRAMES)):
        assert np.abs(clip.vertices(start, stop).numpy() - expected[start:stop]).max() < 2e-3


@pytest.mark.parametrize("name", ["head.abc", "head.fbx"])
def test_damaged_files_end_in_a_sentence(name, written, tmp_path):
    whole, rig = (written / name).read_bytes(), ToyRig()
    cases = {
        "cut": whole[: len(whole) // 2],
        "start": whole[:40],
        "empty": b"",
        "other": b"PK" + whole,
        "noise": whole[:200] + np.random.default_rng(0).integers(0, 256, 4000, dtype=np.uint8).tobytes() + whole[4200:],
    }
    refused = 0
    for case, data in cases.items():
        path = tmp_path / f"{case}_{name}"
        path.write_bytes(data)
        try:
            open_sequence(str(path), rig, OPTIONS).read(0, 1)
        except InputError as error:
            assert path.name in str(error) and "\n" not in str(error)
            refused += 1
    assert refused >= 3


def test_a_mesh_that_is_not_there_is_said(written):
    with pytest.raises(InputError, match="there is no mesh 'body'; it has 'head'"):
        open_sequence(str(written / "head.abc"), ToyRig(), reading_options(fps=25.0, mesh="body"))


def test_inspect_lists_the_meshes_of_an_archive(run, written, tmp_path):
    more = MAKE.replace(
        "bpy.ops.wm.alembic_export", "other = head.copy(); scene.collection.objects.link(other)\nbpy.ops.wm.alembic_export"
    )
    (tmp_path / "make.py").write_text(more)
    shutil.copy(written / "meshes.npz", tmp_path)
    done = subprocess.run(
        [blender(), str(tmp_path / "make.py"), str(tmp_path / "meshes.npz")], capture_output=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    outcome = run("inspect", "head.abc", "reading.fps=25", f"reading.interpreter={blender()}")
    assert outcome.code == 0 and "2, of which 2 move" in outcome.text, outcome.text
    assert "head_001  162 vertices, 6 frames" in outcome.text and "reading.mesh=NAME reads one of them" in outcome.text
