"""glTF, USD, BVH and the script for Blender, read back by readers that are not ours."""

import json
import shutil
import subprocess

import numpy as np
import pygltflib
import pytest
import torch

from riginv.animation.formats import write_formats
from riginv.animation.reduction import reduced
from rigs.blender.twin import blueprint_of, write_blend
from tests.support.animations import NUMBERS, UPRIGHT, errors_of, in_blender, meshes_of, moving, near
from tests.support.blends import blender
from tests.support.toys import ToyRig

IMPORT_GLB = """
bpy.ops.import_scene.gltf(filepath=facts["path"], merge_vertices=False)
fps = scene.render.fps / scene.render.fps_base
found["meshes"] = np.stack([(at(time * fps), points(the("MESH")))[1] for time in facts["times"]])
keys = the("MESH").data.shape_keys
found["names"] = np.array([key.name for key in keys.key_blocks[1:]] if keys else [])
"""
IMPORT_USD = """
bpy.ops.wm.usd_import(filepath=facts["path"])
found["meshes"] = np.stack([(at(frame), points(the("MESH")))[1] for frame in facts["frames"]])
"""
IMPORT_BVH = """
bpy.ops.import_anim.bvh(filepath=facts["path"], axis_up="Y", axis_forward="-Z", update_scene_fps=True)
rig = the("ARMATURE")
def heads(frame):
    at(frame)
    return [list(rig.matrix_world @ rig.pose.bones[name].head) for name in facts["names"]]
found["heads"] = np.array([heads(frame) for frame in facts["frames"]])
found["fps"] = np.array(scene.render.fps / scene.render.fps_base)
"""
RUN_SCRIPT = """
mesh = bpy.data.meshes.new("head")
mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
head = bpy.data.objects.new("head", mesh)
scene.collection.objects.link(head)
head.shape_key_add(name="Basis")
head.shape_key_add(name="bump1")
import runpy
sys.argv = ["blender"]
runpy.run_path(facts["path"], run_name="__main__")
panel, motion = bpy.data.objects["toy controls"], bpy.data.objects["toy motion"]
rows, places = [], []
for frame in facts["frames"]:
    at(frame)
    rows.append([head.data.shape_keys.key_blocks[name].value if name == "bump1" else panel[name] for name in facts["names"]])
    places.append(np.array(motion.matrix_world))
found["controls"], found["motion"] = np.array(rows), np.array(places)
found["scene"] = np.array([scene.frame_start, scene.frame_end, scene.render.fps / scene.render.fps_base])
"""
COUNT_KEYS = """
owners = [panel, head.data.shape_keys]
found["keys"] = sum(len(curve.keyframe_points) for owner in owners for curve in owner.animation_data.action.fcurves)
"""


def validate(path):
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("node is not here: Khronos' glTF validator needs it")
    roots = subprocess.run(["npm", "root", "--global"], capture_output=True, text=True).stdout.strip()
    script = (
        "const fs = require('fs'), validator = require('gltf-validator');"
        "validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))"
        ".then(report => console.log(JSON.stringify(report.issues)))"
    )
    done = subprocess.run(["node", "-e", script, str(path)], capture_output=True, text=True, env=node_environment(roots))
    if "Cannot find module 'gltf-validator'" in done.stderr:
        pytest.skip("npm install --global gltf-validator: Khronos' glTF validator is not here")
    return json.loads(done.stdout)


def node_environment(roots):
    import os

    return {**os.environ, "NODE_PATH": os.pathsep.join([os.environ.get("NODE_PATH", ""), roots])}


@pytest.mark.parametrize("which", ["toy_written", "body_written"])
def test_glb_is_valid(which, request):
    folder, _ = request.getfixturevalue(which)
    issues = validate(folder / "animation.glb")
    assert (issues["numErrors"], issues["numWarnings"], issues["numInfos"]) == (0, 0, 0), issues["messages"]


def accessor(gltf, number):
    found = gltf.accessors[number]
    view = gltf.bufferViews[found.bufferView]
    kind = {5126: np.float32, 5125: np.uint32, 5123: np.uint16}[found.componentType]
    count = found.count * {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[found.type]
    return np.frombuffer(gltf.binary_blob(), kind, count, view.byteOffset)


def test_glb_names_and_weights(toy_written):
    folder, animation = toy_written
    gltf = pygltflib.GLTF2().load(folder / "animation.glb")
    names = gltf.meshes[0].extras["targetNames"]
    assert names == list(animation.rig.coefficient_names)
    weights = next(channel for channel in gltf.animations[0].channels if channel.target.path == "weights")
    sampler = gltf.animations[0].samplers[weights.sampler]
    np.testing.assert_allclose(accessor(gltf, sampler.input), (NUMBERS.numpy() - 101) / 25, atol=1e-6)
    found = accessor(gltf, sampler.output).reshape(len(NUMBERS), -1)
    assert np.array_equal(found, animation.rig.coefficients(animation.controls).numpy())


@pytest.mark.parametrize("which", ["toy_written", "body_written"])
def test_blender_reads_the_glb(which, request, tmp_path):
    folder, animation = request.getfixturevalue(which)
    times = [(number - 101) / 25 for number in NUMBERS.tolist()]
    found = in_blender(tmp_path, IMPORT_GLB, path=str(folder / "animation.glb"), times=times)
    near(1000 * found["meshes"], meshes_of(animation) @ UPRIGHT.T, mm=0.01)
    if which == "toy_written":
        assert found["names"].tolist() == list(animation.rig.coefficient_names)


@pytest.mark.parametrize("which", ["toy_written", "body_written"])
def test_usd_core_reads_the_usd(which, request):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdSkel, Vt

    folder, animation = request.getfixturevalue(which)
    stage = Usd.Stage.Open(str(folder / "animation.usdc"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert stage.GetTimeCodesPerSecond() == 25.0 and stage.GetStartTimeCode() == 101
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache, prim = UsdSkel.Cache(), stage.GetPrimAtPath(f"{root.GetPath()}/mesh")
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query, skeleton = cache.GetSkinningQuery(prim), cache.GetSkelQuery(UsdSkel.BindingAPI(prim).GetInheritedSkeleton())
    moves = skeleton.GetAnimQuery()
    if animation.rig.skeleton() is None:
        assert list(query.GetBlendShapeOrder()) == list(animation.rig.coefficient_names)
        expected = animation.rig.coefficients(animation.controls).numpy()
        found = [np.array(moves.ComputeBlendShapeWeights(number)) for number in NUMBERS.tolist()]
        assert np.array_equal(np.stack(found), expected)
    values = moves.GetPrim().GetAttribute("riginv:controlValues")
    assert list(moves.GetPrim().GetAttribute("riginv:controlNames").Get()) == list(animation.rig.control_names)
    assert np.array_equal(np.array([values.Get(n) for n in NUMBERS.tolist()], np.float32), animation.controls.numpy())
    # USD poses the mesh itself.
    UsdSkel.BakeSkinning(root, Vt.Interval() if hasattr(Vt, "Interval") else interval())
    points = UsdGeom.Mesh(prim).GetPointsAttr()
    meshes = np.stack([np.array(points.Get(number)) for number in NUMBERS.tolist()])
    near(10.0 * meshes, meshes_of(animation), mm=0.01)


def interval():
    from pxr import Gf

    return Gf.Interval.GetFullInterval()


@pytest.mark.parametrize("which", ["toy_written", "body_written"])
def test_blender_reads_the_usd(which, request, tmp_path):
    pytest.importorskip("pxr")
    folder, animation = request.getfixturevalue(which)
    path, frames = str(folder / "animation.usdc"), NUMBERS.tolist()
    found = in_blender(tmp_path, IMPORT_USD, path=path, frames=frames)["meshes"]
    near(1000 * found, meshes_of(animation) @ UPRIGHT.T, mm=0.05)


def joints_of(animation):
    """Where the joints are in the world, `(frame, joint, 3)`, mm."""
    worlds = animation.rig.joint_transforms(animation.controls).double()
    places = worlds[..., 3] @ animation.motion[:, :3, :3].mT + animation.motion[:, None, :3, 3]
    return worlds, places.numpy()


def test_bvhio_reads_the_bvh(body_written):
    bvhio = pytest.importorskip("bvhio")
    folder, animation = body_written
    file = bvhio.readAsBvh(str(folder / "skeleton.bvh"))
    assert file.FrameCount == 15 and file.FrameTime == pytest.approx(1 / 25)
    root = bvhio.readAsHierarchy(str(folder / "skeleton.bvh"))
    layout = {joint.Name: joint for joint, _, _ in root.layout()}
    assert set(animation.rig.joint_names) <= set(layout)
    _, places = joints_of(animation)
    for row, number in enumerate(NUMBERS.tolist()):
        root.loadPose(number - 101)
        found = np.array([list(layout[name].PositionWorld) for name in animation.rig.joint_names])
        assert np.abs(10 * found - places[row]).max() < 0.05


def test_blender_reads_the_bvh(body_written, tmp_path):
    folder, animation = body_written
    frames, names = (NUMBERS - 100).tolist(), list(animation.rig.joint_names)
    found = in_blender(tmp_path, IMPORT_BVH, path=str(folder / "skeleton.bvh"), frames=frames, names=names)
    _, places = joints_of(animation)
    assert float(found["fps"]) == pytest.approx(25.0)
    near(10 * found["heads"], places @ UPRIGHT.T, mm=0.05)


def test_the_script_keys_the_curves_in_blender(toy_written, tmp_path):
    folder, animation = toy_written
    path, names = str(folder / "key_in_blender.py"), list(animation.rig.control_names)
    found = in_blender(tmp_path, RUN_SCRIPT, path=path, frames=NUMBERS.tolist(), names=names)
    np.testing.assert_allclose(found["controls"], animation.controls.numpy(), atol=1e-6)
    assert found["scene"].tolist() == [101, 115, 25]
    turn = np.eye(4)
    turn[:3, :3] = UPRIGHT
    expected = turn @ animation.motion.numpy() @ turn.T
    expected[:, :3, 3] /= 1000
    np.testing.assert_allclose(found["motion"], expected, atol=1e-5)


def test_the_script_keys_reduced_curves_as_they_are(tmp_path):
    animation = reduced(moving(ToyRig(), numbers=torch.arange(10, 70), with_motion=False), 0.3).animation
    write_formats(tmp_path, animation, errors_of(animation), ["blender"])
    names, path = list(animation.rig.control_names), str(tmp_path / "key_in_blender.py")
    script = RUN_SCRIPT.replace(', bpy.data.objects["toy motion"]', ', bpy.data.objects["head"]') + COUNT_KEYS
    found = in_blender(tmp_path, script, path=path, frames=animation.frame_numbers.tolist(), names=names)
    np.testing.assert_allclose(found["controls"], animation.controls.numpy(), atol=1e-5)
    assert int(found["keys"]) == sum(map(len, animation.keys))


@pytest.mark.slow
def test_the_script_plays_the_face_that_was_exported_to_blender(tmp_path, face):
    """The whole way: curves on the .blend of `python -m rigs.blender.export` make the meshes that the rig makes."""
    write_blend(blueprint_of(face), tmp_path / "face.blend", blender())
    animation = moving(face, numbers=torch.arange(3), with_motion=False)
    write_formats(tmp_path, animation, errors_of(animation), ["blender"])
    script = """
bpy.ops.wm.open_mainfile(filepath=facts["blend"])
scene = bpy.context.scene
import runpy
sys.argv = ["blender"]
runpy.run_path(facts["path"], run_name="__main__")
found["meshes"] = np.stack([(at(frame), points(bpy.data.objects["face"]))[1] for frame in range(3)])
"""
    blend, path = str(tmp_path / "face.blend"), str(tmp_path / "key_in_blender.py")
    found = in_blender(tmp_path, script, blend=blend, path=path)
    near(1000 * found["meshes"], meshes_of(animation) @ UPRIGHT.T, mm=0.01)
