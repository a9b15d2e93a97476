"""glTF animations against Blender, as reader and as writer; skipped where there is no Blender."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from riginv.clips.options import ReadingOptions
from rigs.gltf import GltfRig
from rigs.gltf.clip import GltfClip
from tests.support.animations import UPRIGHT, in_blender
from tests.support.avatars import AvatarWriter, cube

NEAR = 1e-3  # mm
RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 120.0, 24000 / 1001, 60000 / 1001)
WAYS = ("LINEAR", "STEP", "CUBICSPLINE")
FRAMES = 16
RNG = np.random.default_rng(3)
CUBE, FACES = cube()


def smooth(size: int, keys: int) -> np.ndarray:
    """Curves `(key, size)` in [0.1, 0.9]."""
    phases, speeds = RNG.uniform(0, 6, size), RNG.uniform(0.2, 0.6, size)
    return 0.5 + 0.4 * np.sin(phases + speeds * np.arange(keys)[:, None])


def with_tangents(values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Keys of a cubic spline `(key, 3, number)` whose tangents are the curves' own."""
    derivatives = np.gradient(values, times, axis=0)
    return np.stack([derivatives, values, derivatives], axis=1)


def avatar() -> tuple[AvatarWriter, list[int]]:
    """A skinned head and skinned teeth with morph targets, a body without, and glasses on a joint."""
    made = AvatarWriter()
    tilt = Rotation.from_euler("x", 20, degrees=True).as_quat().tolist()
    hips = made.node("hips", translation=[0.0, 0.1, 0.0], rotation=tilt)
    neck = made.node("neck", hips, translation=[0.0, 0.15, 0.02])
    binds = [np.eye(4), np.eye(4)]
    binds[0][:3, 3], binds[1][:3, 3] = [0, -0.1, 0], [0, -0.25, 0]
    skin = made.skin([hips, neck], np.array(binds))
    nodes = [hips, neck]
    for name, targets in (("Head", ["open", "smile"]), ("Teeth", ["open"]), ("Body", [])):
        points = 0.08 * CUBE + 0.01 * RNG.normal(size=CUBE.shape) + [0, 0.3, 0]
        moved = [made.accessor(0.02 * RNG.normal(size=CUBE.shape)) for _ in targets]
        shares = np.zeros((8, 4))
        shares[:, 0] = RNG.uniform(0.1, 0.9, 8)
        shares[:, 1] = 1 - shares[:, 0]
        joints = made.accessor(np.tile([0, 1, 0, 0], (8, 1)), "u1")
        primitive = made.primitive(
            made.accessor(points), FACES, moved, JOINTS_0=joints, WEIGHTS_0=made.accessor(shares.astype(np.float32))
        )
        nodes.append(made.node(name, mesh=made.mesh(name, [primitive], targets or None), skin=skin))
    rim = made.primitive(made.accessor(0.02 * CUBE), FACES, [made.accessor(0.01 * RNG.normal(size=CUBE.shape))])
    nodes.append(made.node("Glasses", neck, mesh=made.mesh("Glasses", [rim], ["bend"]), translation=[0.0, 0.05, 0.1]))
    return made, nodes


def moved(how: str, fps: float, first: int, nodes: list[int]) -> list[tuple]:
    """Channels whose frames Blender must show as glTF says.

    Blender goes from one quaternion to the next number by number, and makes up its own tangents: rotations and cubic splines
    have a key at every frame.
    """
    every = 1 if how == "CUBICSPLINE" else 3
    dense, sparse = (np.arange(first, first + FRAMES, step) / fps for step in (1, every))
    hips, neck, head, teeth, _, glasses = nodes
    turns = Rotation.from_euler("xyz", 40 * (smooth(6, FRAMES)[:, :3] - 0.5), degrees=True).as_quat()
    more = Rotation.from_euler("xyz", 70 * (smooth(6, FRAMES)[:, 3:] - 0.5), degrees=True).as_quat()
    numbers = [(hips, "rotation", dense, turns), (neck, "rotation", dense, more)]
    numbers += [(hips, "translation", sparse, 0.1 * smooth(3, len(sparse)))]
    numbers += [(head, "weights", sparse, smooth(2, len(sparse))), (teeth, "weights", sparse, smooth(1, len(sparse)))]
    numbers += [(glasses, "weights", dense, smooth(1, FRAMES))]
    if how == "CUBICSPLINE":
        return [(node, what, times, with_tangents(values, times), how) for node, what, times, values in numbers]
    return [(node, what, times, values, how) for node, what, times, values in numbers]


READ = """
def chosen(name):
    for data in [*bpy.data.objects, *bpy.data.shape_keys]:
        tracks = data.animation_data.nla_tracks if data.animation_data else []
        data.animation_data and setattr(data.animation_data, "action", None)
        for track in tracks:
            if track.name == name:
                data.animation_data.action = track.strips[0].action
                data.animation_data.action_slot = track.strips[0].action_slot

for path, fps, animations in facts["files"]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = round(fps)
    scene.render.fps_base = fps / round(fps)  # the importer multiplies them
    bpy.ops.import_scene.gltf(filepath=path)
    by_mesh = {thing.data.name: thing for thing in bpy.data.objects if thing.type == "MESH"}
    meshes = [by_mesh[name] for name in ("Head", "Teeth", "Glasses")]
    for name, frames in animations.items():
        chosen(name)
        for frame in frames:
            at(frame)
            found[f"{path} {name} {frame}"] = np.concatenate([points(mesh) for mesh in meshes])
"""


@pytest.fixture(scope="module")
def read_by_blender(tmp_path_factory) -> tuple[dict[str, np.ndarray], list[tuple]]:
    """Files with two animations that move the avatar and one that does not, and what Blender shows of the two."""
    folder, files = tmp_path_factory.mktemp("read"), []
    for how in WAYS:
        for fps in RATES:
            made, nodes = avatar()
            prop = made.node("prop", mesh=made.mesh("prop", [made.primitive(made.accessor(CUBE), FACES)]))
            made.animation("Prop", (prop, "translation", [0, 1], np.eye(3)[:2]))
            made.animation("First", *moved(how, fps, 0, nodes))
            made.animation("Second", *moved(how, fps, 7, nodes))
            path = made.write(folder / f"{how}-{fps:.3f}.glb")
            files.append((str(path), fps, {"First": list(range(FRAMES)), "Second": list(range(7, 7 + FRAMES))}))
    return in_blender(folder, READ, files=files), files


@pytest.mark.parametrize("how", WAYS)
def test_every_sample_is_what_blender_shows(how, read_by_blender):
    found, files = read_by_blender
    compared = 0
    for path, fps, animations in files:
        if not Path(path).name.startswith(how):
            continue
        for name, frames in animations.items():
            clip = GltfClip(path, ReadingOptions(animation=name), GltfRig(path))
            assert abs(clip.fps - fps) < 1e-6 and clip.frame_numbers.tolist() == frames, path
            shown = np.stack([found[f"{path} {name} {frame}"] for frame in frames]) * 1000
            off = np.abs(clip.read(0, len(clip)).astype(np.float64) * 1000 @ UPRIGHT.T - shown).max()
            assert off < NEAR, f"{path} {name}: {off}"
            assert np.ptp(shown, axis=0).max() > 5
            compared += len(frames)
    assert compared == 2 * len(RATES) * FRAMES


WRITE = """
rng = np.random.default_rng(1)
for fps, name, options in facts["files"]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = fps
    scene.frame_start, scene.frame_end = 1, facts["frames"]
    bones = bpy.data.armatures.new("bones")
    rig = bpy.data.objects.new("rig", bones)
    scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for number, bone in enumerate(("neck", "head")):
        made = bones.edit_bones.new(bone)
        made.head, made.tail = (0, 0, 0.1 * number), (0, 0, 0.1 * number + 0.1)
        made.parent = bones.edit_bones["neck"] if number else None
    bpy.ops.object.mode_set(mode="OBJECT")
    mesh = bpy.data.meshes.new("face")
    bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=6, radius=0.1)
    face = bpy.context.object
    face.name, face.parent = "Face", rig
    for polygon in face.data.polygons:
        polygon.use_smooth = True
    while face.data.uv_layers:
        face.data.uv_layers.remove(face.data.uv_layers[0])
    heights = np.array([vertex.co.z for vertex in face.data.vertices])
    for bone, weights in (("neck", 0.5 - 4 * heights), ("head", 0.5 + 4 * heights)):
        group = face.vertex_groups.new(name=bone)
        for vertex, weight in enumerate(np.clip(weights, 0, 1).tolist()):
            group.add([vertex], weight, "REPLACE")
    face.modifiers.new("rig", "ARMATURE").object = rig
    face.shape_key_add(name="Basis")
    for key in ("open", "smile"):
        moved = face.shape_key_add(name=key, from_mix=False)
        for point in moved.data:
            point.co += type(point.co)(rng.normal(scale=0.01, size=3).tolist())
    blocks, bone = face.data.shape_keys.key_blocks, rig.pose.bones["head"]
    bone.rotation_mode = "QUATERNION"
    keys = range(1, facts["frames"] + 1) if name.startswith("every") else (1, 6, 11, facts["frames"])
    for frame in keys:
        for key in ("open", "smile"):
            blocks[key].value = rng.uniform(0.1, 0.9)
            blocks[key].keyframe_insert("value", frame=frame)
        bone.rotation_quaternion = type(bone.rotation_quaternion)((1, *rng.uniform(-0.3, 0.3, 3).tolist())).normalized()
        bone.keyframe_insert("rotation_quaternion", frame=frame)
    for curve in face.data.shape_keys.animation_data.action.fcurves:
        for point in curve.keyframe_points:
            point.interpolation = facts["ways"][name.split("_")[-1]]
    meshes = []
    for frame in range(1, facts["frames"] + 1):
        at(frame)
        meshes.append(points(face))
    found[name] = np.array(meshes)
    path = f"{facts['into']}/{name}.glb"
    bpy.ops.export_scene.gltf(filepath=path, export_format="GLB", export_animations=True, **options)
"""
BLENDERS_WAYS = {"linear": "LINEAR", "step": "CONSTANT", "smooth": "BEZIER"}
TOGETHER = {"export_animation_mode": "SCENE", "export_optimize_animation_size": False}
OPTIMISED = {"export_animation_mode": "SCENE", "export_optimize_animation_size": True}
WRITTEN = [
    *((((fps, 1.0), f"sampled_{fps}_{how}", TOGETHER)) for fps in (24, 25, 30, 60) for how in BLENDERS_WAYS),
    ((24, 1.001), "sampled_ntsc_smooth", TOGETHER),  # which Blender writes at 24 times 1.001
    ((30, 1.0), "optimised_smooth", OPTIMISED),
    ((48, 1.0), "optimised_linear", OPTIMISED),
    ((50, 1.0), "every_step", TOGETHER),
]


@pytest.fixture(scope="module")
def written_by_blender(tmp_path_factory) -> tuple[Path, dict[str, np.ndarray]]:
    folder = tmp_path_factory.mktemp("written")
    facts = {"files": WRITTEN, "into": str(folder), "frames": FRAMES, "ways": BLENDERS_WAYS}
    return folder, in_blender(folder, WRITE, **facts)


@pytest.mark.parametrize(("fps", "name"), [(fps, name) for fps, name, _ in WRITTEN])
def test_what_blender_wrote_is_what_blender_showed(fps, name, written_by_blender):
    folder, found = written_by_blender
    rig = GltfRig(str(folder / f"{name}.glb"))
    clip = GltfClip(str(folder / f"{name}.glb"), ReadingOptions(animation=[1, 2]), rig)
    assert set(clip.facts.animation.split(", ")) == {"rig", "Face"}  # Blender made one animation of each object's
    assert abs(clip.fps - fps[0] * fps[1]) < 1e-3 and clip.frame_numbers.tolist() == list(range(1, FRAMES + 1))
    frames, shown = clip.read(0, FRAMES).astype(np.float64) * 1000, found[name] @ UPRIGHT * 1000
    order = [np.abs(frames - shown[:, [vertex]]).max(axis=(0, 2)).argmin() for vertex in range(shown.shape[1])]
    assert len(set(order)) == len(order)  # Blender writes vertices in an order of its own
    assert np.abs(frames[:, order] - shown).max() < NEAR
