"""Every format that curves are written in, read back by a reader that is not ours."""

import csv
import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pygltflib
import pytest
import torch
from scipy.spatial.transform import Rotation

from riginv.animation.animation import Animation
from riginv.animation.formats import FORMATS, check_formats, write_formats
from riginv.animation.live_link import nearest_weights, timecode
from riginv.animation.reduction import reduced
from riginv.clips.live_link import read_live_link
from riginv.errors import InputError
from riginv.rig.arkit import LIVE_LINK_SHAPES
from riginv.rig.interface import Control
from rigs.blender.twin import blueprint_of, write_blend
from tests.support.animations import NUMBERS, UPRIGHT, errors_of, in_blender, meshes_of, moving
from tests.support.blends import blender
from tests.support.toys import BlackBox, ToyRig


@pytest.fixture(scope="module")
def toy_written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("toy")
    animation = moving(ToyRig())
    names = ["csv", "glb", "anim", "blender"]
    if has_usd():
        names.append("usd")
    write_formats(folder, animation, errors_of(animation), names)
    return folder, animation


@pytest.fixture(scope="module")
def body_written(tmp_path_factory, body):
    folder = tmp_path_factory.mktemp("body")
    animation = moving(body)
    write_formats(folder, animation, errors_of(animation), ["glb", "bvh", *(["usd"] if has_usd() else [])])
    return folder, animation


def has_usd():
    try:
        import pxr  # noqa: F401
    except ImportError:
        return False
    return True


def near(found, expected, mm):
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() < mm


def test_tables(toy_written):
    folder, animation = toy_written
    rows = list(csv.reader((folder / "curves.csv").open(newline="")))
    assert rows[0][:4] == ["frame", "seconds", "bump0", "bump1"]
    assert [int(row[0]) for row in rows[1:]] == NUMBERS.tolist()
    table = np.array([[float(value) for value in row] for row in rows[1:]])
    np.testing.assert_allclose(table[:, 2:9], animation.controls.numpy(), rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(table[:, 1], (NUMBERS.numpy() - 101) / 25, atol=1e-6)
    motion = Rotation.from_euler("xyz", table[:, 12:], degrees=True).as_matrix()
    np.testing.assert_allclose(motion, animation.motion[:, :3, :3].numpy(), atol=1e-6)
    np.testing.assert_allclose(table[:, 9:12], animation.motion[:, :3, 3].numpy(), atol=1e-4)
    assert np.abs(np.diff(table[:, 12:], axis=0)).max() < 90  # no jumps by 360 degrees
    facts = json.loads((folder / "curves.json").read_text())
    assert facts["fps"] == 25.0 and facts["made_by"]["bundle"] == "0123abcd"
    assert facts["controls"][5] == {"name": "side", "lower": -1.0, "upper": 1.0, "neutral": 0.0, "unit": ""}
    frames = list(csv.DictReader((folder / "frames.csv").open(newline="")))
    assert frames[3]["flags"] == "outside_reach;not_converged" and frames[1]["worst_region"] == "mouth"
    assert float(frames[-1]["max_error_mm"]) == pytest.approx(1.2)


def test_live_link(tmp_path, face):
    animation = moving(face, numbers=torch.arange(30, 42))
    write_formats(tmp_path / "a", animation, errors_of(animation), ["livelink"])
    write_formats(tmp_path / "b", animation, errors_of(animation), ["livelink"], swap_mouth=True)
    plain, swapped = (list(csv.DictReader((tmp_path / name / "live_link.csv").open(newline=""))) for name in "ab")
    assert plain[0]["Timecode"] == "00:00:01:12.000" and plain[0]["BlendShapeCount"] == "61"
    assert len(plain[0]) == 63 and len(plain) == 12
    assert [row["MouthLeft"] for row in plain] == [row["MouthRight"] for row in swapped]
    yaw = Rotation.from_matrix(animation.motion[:, :3, :3].numpy()).as_euler("YXZ")[:, 0]
    np.testing.assert_allclose([float(row["HeadYaw"]) for row in plain], yaw, atol=1e-6)
    again = read_live_link(tmp_path / "a" / "live_link.csv")
    assert again.fps == pytest.approx(25.0) and again.weights.min() >= 0 and again.weights.max() <= 1


def test_live_link_has_the_columns_of_the_app(tmp_path, face, capture_file):
    animation = moving(face, numbers=torch.arange(2))
    write_formats(tmp_path, animation, errors_of(animation), ["livelink"])
    assert (tmp_path / "live_link.csv").read_text().splitlines()[0] == capture_file.read_text("utf-8-sig").splitlines()[0]


def test_live_link_weights_are_the_nearest(face):
    """Against SciPy's bounded least squares."""
    from scipy.optimize import lsq_linear

    names, deltas = list(face.arkit_deltas()), torch.stack(list(face.arkit_deltas().values()))
    controls = moving(face).controls[:2]
    found = nearest_weights(face, deltas, controls)
    for weights, mesh in zip(found, face(controls)):
        aim = (mesh - face.rest_vertices).flatten().double().numpy()
        best = lsq_linear(deltas.flatten(1).T.double().numpy(), aim, bounds=(0, 1))
        mine = np.square(deltas.flatten(1).T.double().numpy() @ weights.numpy() - aim).sum() / 2
        assert mine <= best.cost * 1.001
    assert len(names) == 52


def test_live_link_of_a_rig_with_arkit_controls():
    class Arkit(ToyRig):
        def __init__(self):
            super().__init__()
            self.controls = (Control("face.JawOpen"), Control("mouth_smile_L"), *self.controls[2:])

    from riginv.animation.live_link import arkit_weights

    animation = moving(Arkit())
    weights = arkit_weights(animation)
    assert torch.equal(weights[:, LIVE_LINK_SHAPES.index("JawOpen")].float(), animation.controls[:, 0])
    assert torch.equal(weights[:, LIVE_LINK_SHAPES.index("MouthSmileLeft")].float(), animation.controls[:, 1])


def test_timecodes_carry_over():
    assert timecode(3661.0) == "01:01:01:00.000"
    assert timecode(0.9999999) == "00:00:01:00.000"
    assert timecode(86400 + 0.25) == "00:00:00:15.000"


def test_maya_anim(toy_written):
    """No free software reads .anim: what the manual's grammar says is written out here once more."""
    folder, animation = toy_written
    key = r"\s+(\S+) (\S+) linear linear 1 1 0;\n"
    curve = (
        r"anim (\S+) (\S+) (\S+) 0 0 (\d+);\nanimData \{\n  input time;\n  output (unitless|angular|linear);\n  weighted 0;\n"
        r"  preInfinity constant;\n  postInfinity constant;\n  keys \{\n((?:" + key.replace("(", "(?:") + r")+)  \}\n\}\n"
    )
    text = (folder / "curves.anim").read_text()
    head, count = re.match(r"((?:\w+ \S+;\n)+)", text)[1], 0
    assert "animVersion 1.1;" in head and "timeUnit pal;" in head and "angularUnit deg;" in head
    rest = text[len(head) :]
    assert re.fullmatch(f"(?:{curve})+", rest)
    for number, found in enumerate(re.finditer(curve, rest)):
        keys = np.array(re.findall(key, found[6]), float)
        assert int(found[4]) == (number if number < 7 else number - 7)
        if number < 7:
            assert found[1] == animation.rig.control_names[number] and found[3] == "toy_controls"
            assert keys[:, 0].tolist() == NUMBERS.tolist()
            np.testing.assert_allclose(keys[:, 1], animation.controls[:, number].numpy(), rtol=1e-6, atol=1e-7)
        else:
            assert found[3] == "toy_motion"
        count += 1
    assert count == 7 + 6


def test_maya_takes_any_frame_rate(tmp_path):
    animation = moving(ToyRig(), fps=23.976)
    write_formats(tmp_path, animation, errors_of(animation), ["anim"])
    text = (tmp_path / "curves.anim").read_text()
    assert "timeUnit sec;" in text and f"    {102 / 23.976:.9g} " in text


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


IMPORT_GLB = """
bpy.ops.import_scene.gltf(filepath=facts["path"], merge_vertices=False)
fps = scene.render.fps / scene.render.fps_base
found["meshes"] = np.stack([(at(time * fps), points(the("MESH")))[1] for time in facts["times"]])
keys = the("MESH").data.shape_keys
found["names"] = np.array([key.name for key in keys.key_blocks[1:]] if keys else [])
"""


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


IMPORT_USD = """
bpy.ops.wm.usd_import(filepath=facts["path"])
found["meshes"] = np.stack([(at(frame), points(the("MESH")))[1] for frame in facts["frames"]])
"""


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


IMPORT_BVH = """
bpy.ops.import_anim.bvh(filepath=facts["path"], axis_up="Y", axis_forward="-Z", update_scene_fps=True)
rig = the("ARMATURE")
def heads(frame):
    at(frame)
    return [list(rig.matrix_world @ rig.pose.bones[name].head) for name in facts["names"]]
found["heads"] = np.array([heads(frame) for frame in facts["frames"]])
found["fps"] = np.array(scene.render.fps / scene.render.fps_base)
"""


def test_blender_reads_the_bvh(body_written, tmp_path):
    folder, animation = body_written
    frames, names = (NUMBERS - 100).tolist(), list(animation.rig.joint_names)
    found = in_blender(tmp_path, IMPORT_BVH, path=str(folder / "skeleton.bvh"), frames=frames, names=names)
    _, places = joints_of(animation)
    assert float(found["fps"]) == pytest.approx(25.0)
    near(10 * found["heads"], places @ UPRIGHT.T, mm=0.05)


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


def test_what_a_rig_cannot_give_is_refused_before_anything_is_written(tmp_path, face):
    animation = moving(BlackBox())
    for name, words in (("glb", "neither"), ("usd", "neither"), ("bvh", "has none"), ("livelink", "ARKit")):
        with pytest.raises(InputError, match=words):
            write_formats(tmp_path, animation, errors_of(animation), ["csv", name])
    with pytest.raises(InputError, match="'fbx' is not known; choose from csv, livelink"):
        check_formats(face, ["fbx"])
    with pytest.raises(InputError, match="formats: bvh holds joints, and rig 'face' has none"):
        check_formats(face, [name for name in FORMATS if name != "usd"])  # which takes a package of its own
    assert not list(tmp_path.iterdir())


def test_names_that_maya_cannot_tell_apart_are_refused():
    rig = ToyRig(last_name="bump.0")
    check_formats(rig, ["anim"])
    rig.controls = (Control("a.b"), Control("a_b"), *rig.controls[2:])
    with pytest.raises(InputError, match=r"'a\.b' and 'a_b' are both 'a_b'"):
        check_formats(rig, ["anim"])


def test_what_makes_no_animation_is_refused():
    rig = ToyRig()
    good = {"rig": rig, "controls": torch.zeros(3, 7), "fps": 30.0, "frame_numbers": torch.arange(3)}
    for change, words in (
        ({"controls": torch.zeros(3, 6)}, r"need \(3, 7\)"),
        ({"controls": torch.full((3, 7), torch.nan)}, "frame 0: control 'bump0' is not a finite number"),
        ({"fps": 0.0}, "fps is 0.0, expected a number above 0"),
        ({"fps": float("nan")}, "fps is nan"),
        ({"frame_numbers": torch.tensor([0, 0, 1])}, "do not rise"),
        ({"frame_numbers": torch.arange(0), "controls": torch.zeros(0, 7)}, "no frames"),
        ({"motion": torch.eye(4)}, r"expected \(3, 4, 4\)"),
    ):
        with pytest.raises(InputError, match=words):
            Animation(**(good | change))


def test_usd_without_its_package_is_a_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(InputError, match=r"pip install 'riginv\[usd\]'"):
        check_formats(ToyRig(), ["usd"])


def test_the_script_keys_reduced_curves_as_they_are(tmp_path):
    animation = reduced(moving(ToyRig(), numbers=torch.arange(10, 70), with_motion=False), 0.3).animation
    write_formats(tmp_path, animation, errors_of(animation), ["blender"])
    names, path = list(animation.rig.control_names), str(tmp_path / "key_in_blender.py")
    script = RUN_SCRIPT.replace(', bpy.data.objects["toy motion"]', ', bpy.data.objects["head"]') + COUNT_KEYS
    found = in_blender(tmp_path, script, path=path, frames=animation.frame_numbers.tolist(), names=names)
    np.testing.assert_allclose(found["controls"], animation.controls.numpy(), atol=1e-5)
    assert int(found["keys"]) == sum(map(len, animation.keys))


COUNT_KEYS = """
owners = [panel, head.data.shape_keys]
found["keys"] = sum(len(curve.keyframe_points) for owner in owners for curve in owner.animation_data.action.fcurves)
"""


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
