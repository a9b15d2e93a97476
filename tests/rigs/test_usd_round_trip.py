"""What riginv and Blender write as USD is read back as it was; skipped where usd-core or Blender is not installed."""

import csv
import subprocess

import numpy as np
import pytest

from riginv.animation.usd import write
from riginv.clips.clip import Clip
from riginv.clips.open import open_sequence
from riginv.clips.topology import check_topology
from riginv.clips.units import resolve_units
from tests.conftest import ROOT
from tests.support.animations import NUMBERS, meshes_of, moving
from tests.support.blends import blender
from tests.support.clips import performance, reading_options, write_npz
from tests.support.toys import ToyRig
from tests.support.usd_stages import baked, opened

FRAMES = 12
MAKE = """
import os, sys, bpy, numpy as np
folder = sys.argv[-1]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps, scene.frame_start, scene.frame_end = 25, 1, FRAMES
random = np.random.default_rng(0)
rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("bones"))
scene.collection.objects.link(rig)
bpy.context.view_layer.objects.active = rig
bpy.ops.object.mode_set(mode="EDIT")
for number, parent in ((0, None), (1, "bone 0")):
    bone = rig.data.edit_bones.new(f"bone {number}")
    bone.head, bone.tail = (0, 0, number * 0.1), (0, 0, number * 0.1 + 0.1)
    bone.parent = rig.data.edit_bones[parent] if parent else None
bpy.ops.object.mode_set(mode="OBJECT")
heads = []
for name, size in (("Head", 0.1), ("Teeth", 0.05)):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=10, ring_count=6, radius=size)
    head = bpy.context.object
    head.name, head.parent = name, rig
    head.modifiers.new("skin", "ARMATURE").object = rig
    for number in range(2):
        group = head.vertex_groups.new(name=f"bone {number}")
        for vertex in head.data.vertices:
            group.add([vertex.index], abs(number - min(1, max(0, 0.5 + vertex.co.z / 0.2))), "REPLACE")
    head.shape_key_add(name="Basis")
    for shape in ("smile", "jaw.open"):
        key = head.shape_key_add(name=shape, from_mix=False)
        for point in key.data:
            point.co = [one + 0.01 * offset for one, offset in zip(point.co, random.normal(size=3))]
        for frame in range(1, FRAMES + 1):
            key.value = random.uniform()
            key.keyframe_insert("value", frame=frame)
    heads.append(head)
for frame in range(1, FRAMES + 1):
    rig.location = random.normal(size=3)
    rig.keyframe_insert("location", frame=frame)
    for bone in rig.pose.bones:
        bone.rotation_mode, bone.rotation_euler = "XYZ", 0.4 * random.normal(size=3)
        bone.keyframe_insert("rotation_euler", frame=frame)
bpy.ops.mesh.primitive_cube_add(size=0.1)
truth = {head.name: [] for head in heads}
for frame in range(1, FRAMES + 1):
    scene.frame_set(frame)
    for head in heads:
        thing = head.evaluated_get(bpy.context.evaluated_depsgraph_get())
        points = np.empty(3 * len(thing.data.vertices), np.float32)
        thing.data.vertices.foreach_get("co", points)
        matrix = np.array(thing.matrix_world)
        truth[head.name].append(points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
np.savez(folder + "/truth.npz", **truth)
bpy.ops.wm.usd_export(filepath=folder + "/skins.usdc", export_animation=True)
bpy.ops.wm.usd_export(filepath=folder + "/text.usda", export_animation=True, root_prim_path="", use_instancing=True)
bpy.ops.wm.usd_export(filepath=folder + "/packed.usdz", export_animation=True)
bpy.ops.wm.usd_export(filepath=folder + "/points.usdc", export_animation=True, export_armatures=False, export_shapekeys=False)
os._exit(0)
"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blender")
    (folder / "make.py").write_text(MAKE.replace("FRAMES", str(FRAMES)))
    done = subprocess.run([blender(), str(folder / "make.py"), str(folder)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize("name", ["skins.usdc", "text.usda", "packed.usdz", "points.usdc"])
def test_blenders_exports_move_as_in_blender(name, exported):
    with np.load(exported / "truth.npz") as truth:
        clip = opened(exported / name, mesh=["Head", "Teeth"])
        expected = np.concatenate([truth[path.split("/")[-2]] for path in clip.facts.meshes], axis=1)
        assert np.abs(clip.read(0, FRAMES) - expected).max() * 1000 < 1e-3
        assert (
            np.abs(clip.read(0, FRAMES) - baked(exported / name, clip.facts.meshes, range(1, FRAMES + 1))).max() * 1000 < 1e-3
        )
        assert (len(clip), clip.fps, clip.up, clip.unit_mm) == (FRAMES, 25, "z", 1000) and not clip.facts.notes
        assert bool(clip.facts.animation) == (name != "points.usdc") and len(clip.facts.other_meshes) == 1
        alone = opened(exported / name, vertices=truth["Teeth"].shape[1] + truth["Head"].shape[1])
        assert alone.facts.meshes == clip.facts.meshes


@pytest.mark.parametrize("kind", ["blend shapes", "blend shapes that stay", "joints"])
def test_our_own_stages_are_the_meshes_that_were_written(kind, request, tmp_path):
    rig = request.getfixturevalue("body") if kind == "joints" else ToyRig()
    animation = moving(rig, with_motion=kind != "blend shapes that stay")
    write(tmp_path / "animation.usdc", animation)
    clip = opened(tmp_path / "animation.usdc")
    expected, held = meshes_of(animation), np.isin(clip.frame_numbers, NUMBERS.numpy())
    assert clip.frame_numbers[held].tolist() == NUMBERS.tolist() and len(clip) == 15 and clip.fps == 25
    assert np.abs(10 * clip.read(0, 15)[held] - expected).max() < 2e-2
    (path,) = clip.facts.meshes
    assert np.abs(clip.read(0, 15)[held] - baked(tmp_path / "animation.usdc", [path], NUMBERS.tolist())).max() * 10 < 1e-3
    assert clip.facts.notes == ("3 of 15 frames have no sample of their own: USD interpolates them.",)


def test_curves_written_as_usd_are_inverted_to_the_same_curves(run, tmp_path):
    rig = ToyRig()
    write_npz(tmp_path / "take.npz", performance(rig, 20), rig.faces.numpy())
    common = (
        "rig=toy",
        f"--config-dir={ROOT / 'tests/conf'}",
        "method=levenberg_marquardt",
        "motion=keep",
        "look.page=false",
        "look.sheet=false",
    )
    first = run("invert", *common, f"clip={tmp_path / 'take.npz'}", "out=first", "formats=[usd]")
    assert first.code == 0, first.text
    second = run("invert", *common, f"clip={tmp_path / 'first/animation.usdc'}", "out=second")
    assert second.code == 0 and "20 frames at 24 a second" in second.text, second.text
    tables = []
    for name in ("first", "second"):
        with (tmp_path / name / "curves.csv").open(newline="") as file:
            tables.append([{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)])
    assert len(tables[0]) == len(tables[1]) == 20
    for before, after in zip(*tables):
        assert before["frame"] == after["frame"]
        assert all(abs(before[name] - after[name]) < 2e-3 for name in rig.control_names)


def test_a_clip_of_the_rig_is_opened_by_its_name_in_a_process_of_its_own(tmp_path):
    rig = ToyRig()
    animation = moving(rig)
    write(tmp_path / "animation.usdc", animation)
    sequence = open_sequence(str(tmp_path / "animation.usdc"), rig, reading_options())
    assert not check_topology(sequence, rig)
    clip = Clip(sequence, resolve_units(sequence, rig, reading_options()))
    held = np.isin(clip.frame_numbers.numpy(), NUMBERS.numpy())
    assert np.abs(clip.vertices(0, 15).numpy()[held] - meshes_of(animation)).max() < 2e-2
