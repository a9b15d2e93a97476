"""Takes, meshes and rates of FBX and Alembic files that Blender wrote; skipped where there is no Blender."""

import subprocess

import numpy as np
import pytest

from riginv.errors import InputError
from rigs.blender.clip import BlenderClip
from tests.support.blends import blender
from tests.support.clips import reading_options

MAKE = """
import math, os, sys, bpy, numpy as np
folder, truth = sys.argv[-1], {}

def empty(fps, base=1.0):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = fps, base
    return scene

def ball(name, size, shaped=True):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=10, ring_count=6, radius=size)
    thing = bpy.context.object
    thing.name = name
    if shaped:
        thing.shape_key_add(name="Basis")
        for number, point in enumerate(thing.shape_key_add(name="smile", from_mix=False).data):
            point.co = [one + 0.01 * math.sin(number + axis) for axis, one in enumerate(point.co)]
    return thing

def points(scene, things, frames):
    found = []
    for frame in frames:
        scene.frame_set(frame)
        row = []
        for thing in things:
            thing = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
            co = np.empty(3 * len(thing.data.vertices), np.float32)
            thing.data.vertices.foreach_get("co", co)
            matrix = np.array(thing.matrix_world)
            row.append(co.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
        found.append(np.concatenate(row))
    x, y, z = np.moveaxis(np.stack(found), 2, 0)
    return np.stack([x, z, -y], axis=2)

scene = empty(30, 1.001)
scene.frame_end = 200
head, teeth = ball("Head", 0.1), ball("Teeth", 0.05)
ball("Hat", 0.1, shaped=False)
for thing in (head, teeth):
    key = thing.data.shape_keys.key_blocks["smile"]
    for frame in range(1, 201):
        key.value = 0.5 + 0.5 * math.sin(frame * 1.3 + len(thing.name))
        key.keyframe_insert("value", frame=frame)
truth["shots"] = points(scene, [head, teeth], range(1, 201))
plain = dict(bake_anim_simplify_factor=0.0, bake_anim_use_nla_strips=False, bake_anim_use_all_actions=False)
bpy.ops.export_scene.fbx(filepath=folder + "/shots.fbx", **plain)
bpy.ops.wm.alembic_export(filepath=folder + "/shots.abc", start=1, end=200, as_background_job=False)
blur = dict(xsamples=3, gsamples=3, sh_open=-1 / 3, sh_close=2 / 3)  # at -1/3, 0 and 1/3
bpy.ops.wm.alembic_export(filepath=folder + "/blur.abc", start=1, end=200, as_background_job=False, **blur)

scene = empty(24)
head = ball("Head", 0.1, shaped=False)
rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("bones"))
scene.collection.objects.link(rig)
bpy.context.view_layer.objects.active = rig
bpy.ops.object.mode_set(mode="EDIT")
bone = rig.data.edit_bones.new("bone")
bone.head, bone.tail = (0, 0, 0), (0, 0, 0.2)
bpy.ops.object.mode_set(mode="OBJECT")
head.parent = rig
head.modifiers.new("skin", "ARMATURE").object = rig
head.vertex_groups.new(name="bone").add(range(len(head.data.vertices)), 1, "REPLACE")
rig.animation_data_create()
for name, count, size in (("Idle", 12, 0.0), ("Walk", 20, 0.4), ("Run", 30, 0.8)):
    rig.animation_data.action = bpy.data.actions.new(name)
    pose = rig.pose.bones[0]
    pose.rotation_mode = "XYZ"
    for frame in range(1, count + 1):
        pose.rotation_euler = (size * math.sin(frame * 0.4), 0, size * 0.1 * frame)
        pose.keyframe_insert("rotation_euler", frame=frame)
    truth[name] = points(scene, [head], range(1, count + 1))
bpy.ops.export_scene.fbx(filepath=folder + "/takes.fbx", bake_anim_simplify_factor=0.0, add_leaf_bones=False)
np.savez(folder + "/truth.npz", **truth)
os._exit(0)
"""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blender")
    (folder / "make.py").write_text(MAKE)
    done = subprocess.run([blender(), str(folder / "make.py"), str(folder)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    with np.load(folder / "truth.npz") as file:
        return folder, {name: file[name] for name in file.files}


def opened(path, vertices=None, **options):
    return BlenderClip(str(path), reading_options(**options), vertices)


@pytest.mark.parametrize("name", ["shots.fbx", "shots.abc", "blur.abc"])
def test_several_meshes_at_a_rate_that_is_no_whole_number(name, written):
    folder, truth = written
    clip = opened(folder / name, mesh=["Teeth", "Head"])
    assert clip.facts.meshes == ("Head", "Teeth") and clip.facts.other_meshes == ("Hat",)
    assert clip.fps == pytest.approx(30 / 1.001, abs=1e-4) and clip.frame_numbers.tolist() == list(range(1, 201))
    assert np.abs(clip.read(0, 200) - truth["shots"]).max() * 1000 < 2e-3
    assert clip.facts.format == ("FBX" if name.endswith("fbx") else "Alembic")
    assert clip.facts.rate_source == ("the FBX's own rate" if name.endswith("fbx") else "the archive's time sampling")
    assert len(clip.facts.notes) == (name == "blur.abc")
    sizes = clip.faces.sizes.sum()
    assert sizes == len(clip.faces.corners) and clip.faces.corners.max() == clip.vertex_count - 1


@pytest.mark.parametrize("name", ["shots.fbx", "shots.abc"])
def test_which_mesh_is_meant_is_asked_or_follows_from_the_rig(name, written):
    folder, truth = written
    vertices = truth["shots"].shape[1]
    with pytest.raises(InputError, match=rf"{name}: expected one mesh, .*those that move are: Head .*, Teeth"):
        opened(folder / name)
    clip = opened(folder / name, vertices)
    assert clip.facts.meshes == ("Head", "Teeth") and f"the rig's {vertices} vertices" in clip.facts.notes[0]
    with pytest.raises(InputError, match=rf"{name}: there is no mesh 'Nose'; it has 'Hat', 'Head', 'Teeth'"):
        opened(folder / name, mesh=["Head", "Nose"])


@pytest.mark.parametrize(
    ("asked", "name", "others"),
    [
        (None, "Run", ("Idle", "Walk")),  # the first that moves the mesh: Blender writes them by name
        ("Walk", "Walk", ("Idle", "Run")),
        ("Rig|Run", "Run", ("Idle", "Walk")),
        (3, "Walk", ("Idle", "Run")),
        ("1", "Idle", ("Run", "Walk")),
    ],
)
def test_a_take_is_the_first_that_moves_the_mesh_or_the_one_that_is_asked_for(asked, name, others, written):
    folder, truth = written
    clip = opened(folder / "takes.fbx", animation=asked)
    assert clip.facts.animation == f"Rig|{name}" and clip.facts.other_animations == tuple(f"Rig|{one}" for one in others)
    assert len(clip) == len(truth[name]) and np.abs(clip.read(0, len(clip)) - truth[name]).max() * 1000 < 2e-3
    assert any("No animation moves the mesh" in note for note in clip.facts.notes) == (name == "Idle")


def test_animations_that_are_not_there_are_said(written):
    folder, _ = written
    for asked in ("Jump", 4, 0):
        with pytest.raises(InputError, match=rf"takes.fbx: reading.animation={asked} names 0 animations; it has 'Rig.Idle'"):
            opened(folder / "takes.fbx", animation=asked)
    with pytest.raises(InputError, match=r"shots.abc: an Alembic file has no animations"):
        opened(folder / "shots.abc", animation=1, mesh="Head")


@pytest.mark.parametrize("name", ["shots.fbx", "shots.abc"])
def test_another_rate_is_played_when_asked(name, written):
    folder, truth = written
    clip = opened(folder / name, mesh="Head", fps=60 / 1.001)
    assert clip.fps == pytest.approx(60 / 1.001) and clip.facts.rate_source == "reading.fps"
    assert clip.frame_numbers.tolist() == list(range(2, 401))
    head = truth["shots"][:, : clip.vertex_count]
    assert np.abs(clip.read(0, 399)[::2] - head).max() * 1000 < 5e-2
