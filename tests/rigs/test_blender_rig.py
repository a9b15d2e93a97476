"""Any .blend as a rig: what is found in it, how it is chosen, what it evaluates to, and what is wrong with it."""

import math

import numpy as np
import pytest
import torch

from riginv.errors import InputError
from riginv.rig.contract import check_rig
from rigs.blender.rig import BlenderRig
from tests.config.test_bad_input import refused
from tests.support.blends import make_blend

# The corners of `cube` as riginv sees them: mm, y up.
REST = 1000.0 * torch.tensor([(x, z, -y) for x in (-1, 1) for y in (-1, 1) for z in (0, 2)])

FACE = """
face = cube("face")
shape(face, "smile", (0.5, 0, 0))
shape(face, "jaw", (0, 0, -0.25))
shape(face, "fix", (0, 0.125, 0))
shape(face, "old", (9, 9, 9)).mute = True
panel = add("panel")
for name, default in (("mouth", 0.0), ("unused", 0.0), ("squash", 0.5)):
    panel[name] = default
panel.id_properties_ui("mouth").update(min=-1, max=1, soft_min=0, soft_max=0.8, default=0.0)
panel.id_properties_ui("squash").update(min=0, max=1, default=0.5)
keys = face.data.shape_keys
keys.key_blocks["jaw"].slider_max = 2
drive(keys, 'key_blocks["smile"].value', panel, '["mouth"]', "v*2")
drive(keys, 'key_blocks["fix"].value', panel, '["squash"]')
keys.key_blocks["jaw"].value = 1
keys.key_blocks["jaw"].keyframe_insert("value", frame=1)
other = cube("other")
shape(other, "elsewhere", (1, 0, 0))
face.location = (0, 0, 0.5)
"""

ARM = """
arm = cube("arm")
rig = bones("rig", ((0, 0, 0), (0, 0, 1)), ((0, 0, 1), (0, 0, 2)), ((0, 0, 2), (0, 0, 2.5)))
for number, group in enumerate(("bone0", "bone1")):
    arm.vertex_groups.new(name=group).add([i for i in range(8) if i % 2 == number], 1.0, "REPLACE")
modifier = arm.modifiers.new("skin", "ARMATURE")
modifier.object = rig
first, second, third = rig.pose.bones
first.lock_location = first.lock_rotation = (True, True, True)
second.lock_rotation = (False, True, False)
limit = second.constraints.new("LIMIT_ROTATION")
limit.owner_space, limit.use_limit_x, limit.min_x, limit.max_x = "LOCAL", True, -math.pi / 6, math.pi / 2
limit = second.constraints.new("LIMIT_LOCATION")
limit.owner_space, limit.use_min_y, limit.min_y = "LOCAL", True, 0.0
second.lock_location = (True, False, True)
third.bone.hide = True
"""


def controls_of(rig):
    return {c.name: (round(c.lower, 4), round(c.upper, 4), round(c.neutral, 4), c.unit) for c in rig.controls}


@pytest.fixture(scope="module")
def face_file(tmp_path_factory):
    return make_blend(tmp_path_factory.mktemp("blend") / "face.blend", FACE)


@pytest.fixture(scope="module")
def face_rig(face_file):
    rig = BlenderRig(str(face_file), mesh="face", workers=1)
    yield rig
    rig.pool.close()


def test_controls_are_what_an_animator_moves_with_the_limits_of_their_sliders(face_rig):
    assert controls_of(face_rig) == {"mouth": (0, 0.8, 0, ""), "squash": (0, 1, 0.5, ""), "jaw": (0, 2, 0, "")}
    assert face_rig.name == "face" and not face_rig.differentiable


def test_a_pose_is_the_mesh_in_world_space_in_mm_with_y_up(face_rig):
    rest = REST + torch.tensor([0, 500.0, 0]) + torch.tensor([0, 0, -62.5])  # the object's place, and squash at 0.5
    torch.testing.assert_close(face_rig.rest_vertices, rest, atol=1e-3, rtol=0)
    found = face_rig(torch.tensor([[0.25, 0.5, 0.0], [0.0, 1.0, 2.0], [0.8, 0.5, 0.0]]))
    moves = [[250.0, 0, 0], [0, -500.0, -62.5], [500.0, 0, 0]]  # a driven shape key stops at its slider's end
    torch.testing.assert_close(found, rest + torch.tensor(moves)[:, None], atol=1e-3, rtol=0)


def test_faces_are_triangles_seen_from_outside(face_rig):
    a, b, c = face_rig.rest_vertices[face_rig.faces].unbind(1)
    outward = ((a + b + c) / 3 - face_rig.rest_vertices.mean(dim=0)) * torch.linalg.cross(b - a, c - a)
    assert len(face_rig.faces) == 12 and (outward.sum(dim=1) > 0).all()


def test_a_file_keeps_the_contract(face_rig):
    check_rig(face_rig)


def test_a_config_includes_excludes_renames_and_bounds_by_glob(face_file):
    rig = BlenderRig(
        str(face_file),
        mesh="face",
        include=["*"],
        exclude=["jaw"],
        rename={"m*": "lip_*"},
        bounds={"lip_*": [0, 0.5]},
        workers=1,
    )
    assert controls_of(rig) == {"lip_outh": (0, 0.5, 0, ""), "squash": (0, 1, 0.5, "")}
    moved = rig(torch.tensor([[0.5, 0.5]])) - rig.rest_vertices
    torch.testing.assert_close(moved, torch.tensor([500.0, 0, 0]).expand_as(moved), atol=1e-3, rtol=0)
    rig.pool.close()


@pytest.fixture(scope="module")
def arm_file(tmp_path_factory):
    return make_blend(tmp_path_factory.mktemp("blend") / "arm.blend", ARM)


def test_free_bones_are_controls_with_the_limits_of_their_constraints(arm_file):
    rig = BlenderRig(str(arm_file), workers=1)
    assert controls_of(rig) == {
        "bone1.location_y": (0, 100, 0, "mm"),
        "bone1.rotation_x": (-30, 90, 0, "deg"),
        "bone1.rotation_z": (-45, 45, 0, "deg"),
    }
    found = rig(torch.tensor([[0.0, 90.0, 0.0], [50.0, 0.0, 0.0]]))
    upper = torch.arange(8) % 2 == 1
    torch.testing.assert_close(found[:, ~upper], rig.rest_vertices[~upper].expand(2, -1, -1), atol=1e-2, rtol=0)
    lengthened = rig.rest_vertices[upper] + torch.tensor([0, 50.0, 0])  # a bone's y runs along it
    torch.testing.assert_close(found[1, upper], lengthened, atol=1e-2, rtol=0)
    x, y, z = (rig.rest_vertices[upper] - torch.tensor([0, 1000.0, 0])).unbind(1)
    turned = torch.stack([x, -z, y], dim=1) + torch.tensor([0, 1000.0, 0])
    torch.testing.assert_close(found[0, upper], turned, atol=1e-2, rtol=0)  # a quarter turn about the bone's head
    rig.pool.close()


def test_bones_that_drive_and_their_properties_are_controls_too(tmp_path):
    script = """
face = cube("face")
for name in ("smile", "blink", "spin"):
    shape(face, name, (1, 0, 0))
panel = bones("panel", ((0, 0, 0), (0, 0, 1)), ((5, 0, 0), (5, 0, 1)))
apart = bones("apart", ((9, 0, 0), (9, 0, 1)))
first, second = panel.pose.bones
second.lock_location = second.lock_rotation = (True, True, True)
first.lock_location, first.lock_rotation = (True, False, True), (True, True, True)
second["blink [L]"] = 0.0
second.id_properties_ui("blink [L]").update(min=0, max=1, default=0.0)
panel.data["spin"] = (0.0, 0.0)
keys = face.data.shape_keys
curve = keys.key_blocks["smile"].driver_add("value")
variable = curve.driver.variables.new()
variable.name, variable.type = "v", "TRANSFORMS"
target = variable.targets[0]
target.id, target.bone_target, target.transform_type, target.transform_space = panel, "bone0", "LOC_Y", "LOCAL_SPACE"
curve.driver.expression = "v*5"
drive(keys, 'key_blocks["blink"].value', panel, 'pose.bones["bone1"]["blink [L]"]')
drive(keys, 'key_blocks["spin"].value', panel.data, '["spin"][1]')
"""
    rig = BlenderRig(str(make_blend(tmp_path / "panel.blend", script)), mesh="face", workers=1)
    limits = {"bone0.location_y": (-100, 100, 0, "mm"), "blink [L]": (0, 1, 0, ""), "spin[1]": (0, 1, 0, "")}
    assert controls_of(rig) == limits
    for name, value, expected in (("bone0.location_y", 50.0, 250.0), ("blink [L]", 0.5, 500.0), ("spin[1]", 0.75, 750.0)):
        controls = rig.neutral_controls[None].clone()
        controls[0, rig.control_names.index(name)] = value
        moved = rig(controls)[0] - rig.rest_vertices
        torch.testing.assert_close(moved, torch.tensor([expected, 0, 0]).expand_as(moved), atol=1e-2, rtol=0)
    rig.pool.close()


def test_modifiers_count_and_scale_and_unit_too(tmp_path):
    script = """
thing = cube("thing")
shape(thing, "wide", (0.5, 0, 0), only=lambda co: co.x > 0)
smooth = thing.modifiers.new("smooth", "SUBSURF")
smooth.levels, smooth.use_limit_surface = 1, False
thing.scale = (2, 2, 2)
thing.hide_viewport = True
scene.unit_settings.scale_length = 0.01
"""
    rig = BlenderRig(str(make_blend(tmp_path / "thing.blend", script)), workers=1)
    assert len(rig.rest_vertices) == 8 + 6 + 12 and controls_of(rig) == {"wide": (0, 1, 0, "")}
    # Catmull and Clark leave the centre of a face where it is: at 2 units, twice as large, a unit being 1 cm.
    assert math.isclose(float(rig.rest_vertices[:, 1].max()), 40.0, rel_tol=1e-5)
    moved = rig(torch.ones(1, 1))[0] - rig.rest_vertices
    assert math.isclose(float(moved[:, 0].max()), 10.0, rel_tol=1e-5) and moved[:, 1:].abs().max() < 1e-3
    rig.pool.close()


BROKEN = {
    "two meshes": ("cube('a'); shape(cube('b'), 'x', (1, 0, 0))", {}, "choose one with rig.mesh=NAME: 'a', 'b'"),
    "other mesh": ("shape(cube('a'), 'x', (1, 0, 0))", {"mesh": "head"}, "there is no mesh 'head'; it has 'a'"),
    "no mesh": ("add('empty')", {}, "it holds no mesh"),
    "nothing moves": ("cube('a')", {}, "nothing moves the mesh 'a'"),
    "python": (
        "a = cube('a'); shape(a, 'x', (1, 0, 0)); shape(a, 'y', (1, 0, 0)); p = add('p'); p['c'] = 0.0\n"
        "drive(a.data.shape_keys, 'key_blocks[\"x\"].value', p, '[\"c\"]', 'bpy.app.version[0] * v')",
        {},
        "1 drivers need Python that Blender does not run unasked, such as 'bpy.app",
    ),
    "changing mesh": (
        "a = cube('a'); shape(a, 'x', (-2, 0, 0), only=lambda co: co.x > 0); a.modifiers.new('weld', 'WELD')",
        {"bounds": {"x": [0, 1]}},
        "switch off the modifier",
    ),
    "no such control": ("shape(cube('a'), 'smile', (1, 0, 0))", {"include": ["smlie"]}, "such as smile"),
    "no list": ("shape(cube('a'), 'smile', (1, 0, 0))", {"include": "smile"}, "rig.include=[smile]"),
    "no workers": ("shape(cube('a'), 'smile', (1, 0, 0))", {"workers": 0}, "rig.workers is 0"),
    "no time": ("shape(cube('a'), 'smile', (1, 0, 0))", {"timeout_s": 0}, "rig.timeout_s is 0"),
    "nothing left": ("shape(cube('a'), 'smile', (1, 0, 0))", {"exclude": ["*"]}, "leave none of its 1 controls"),
    "bounds": ("shape(cube('a'), 'smile', (1, 0, 0))", {"bounds": {"smile": [1, 0]}}, "lower 1.0 >= upper 0.0"),
    "one bound": ("shape(cube('a'), 'smile', (1, 0, 0))", {"bounds": {"smile": [1]}}, "expected [lower, upper]"),
}


@pytest.mark.parametrize("case", list(BROKEN))
def test_what_is_wrong_with_a_file_is_said_in_a_sentence(case, tmp_path):
    script, arguments, says = BROKEN[case]
    path = make_blend(tmp_path / "broken.blend", script)
    with pytest.raises(InputError) as error:
        rig = BlenderRig(str(path), **{"workers": 1, **arguments})
        rig(rig.upper[None])
    assert says in str(error.value) and "\n" not in str(error.value)


def test_a_pose_that_ends_blender_is_told_with_its_controls(tmp_path):
    script = """
a = cube("a"); shape(a, "x", (1, 0, 0)); p = add("p"); p["c"] = 0.0
drive(a.data.shape_keys, 'key_blocks["x"].value', p, '["c"]', "v if v < 0.75 else __import__('os')._exit(7)")
"""
    rig = BlenderRig(str(make_blend(tmp_path / "fatal.blend", script)), scripts=True, workers=1)
    assert torch.isfinite(rig(torch.tensor([[0.5]]))).all()
    with pytest.raises(InputError, match=r"fatal: pose 1 cost 3 workers in a row.*ended with code 7.*it moves: c 0\.8"):
        rig(torch.tensor([[0.5], [0.8], [0.2]]))
    rig.pool.close()


def test_python_of_a_trusted_file_may_run(tmp_path):
    script, _, _ = BROKEN["python"]
    rig = BlenderRig(str(make_blend(tmp_path / "trusted.blend", script)), scripts=True, workers=1)
    moved = rig(torch.tensor([[0.1, 0.0]]))[0] - rig.rest_vertices
    assert rig.control_names == ("c", "y") and math.isclose(float(moved[0, 0]), 400.0, rel_tol=0.3)
    rig.pool.close()


def test_damaged_files_end_in_a_sentence(tmp_path, face_file, run):
    data = face_file.read_bytes()
    for name, content in {"text": b"no blend", "empty": b"", "cut": data[: len(data) // 2], "head": data[:40]}.items():
        (tmp_path / f"{name}.blend").write_bytes(content)
        with pytest.raises(InputError, match=rf"{name}\.blend"):
            BlenderRig(str(tmp_path / f"{name}.blend"), workers=1)
    refused(run("check", "rig=blender", f"rig.file={tmp_path}/text.blend"), "this is no .blend file")


def test_the_command_samples_a_file_into_pairs(face_file, tmp_path, monkeypatch, face_rig):
    from riginv.config.building import build
    from rigs.blender.sample import write_pairs

    assert build({"_target_": "rigs.blender.rig.BlenderRig", "file": str(face_file), "mesh": "face"}).name == "face"
    controls = torch.rand(5, 3)
    write_pairs(face_rig, controls, tmp_path / "pairs.npz")
    write_pairs(face_rig, controls, tmp_path / "pairs")
    table = np.load(tmp_path / "pairs.npz", allow_pickle=False)
    assert {path.stem for path in (tmp_path / "pairs").iterdir()} == set(table.files)
    for name in table.files:
        np.testing.assert_array_equal(np.load(tmp_path / f"pairs/{name}.npy", allow_pickle=False), table[name])
    np.testing.assert_allclose(table["vertices"], face_rig(controls).numpy(), atol=1e-4)
    assert list(table["control_names"]) == ["mouth", "squash", "jaw"] and table["neutral"].tolist() == [0, 0.5, 0]
