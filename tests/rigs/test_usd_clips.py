"""USD stages whose meshes are moved by transforms, instances, layers and splines; skipped where usd-core is not installed."""

import numpy as np
import pytest

from riginv.errors import InputError
from tests.support.usd_stages import Gf, Sdf, Usd, UsdGeom, add_mesh, new_stage, opened

TIMES = np.arange(1.0, 13.0)


def turned(points, axis, degrees):
    """Points `(vertex, 3)` turned about an axis, written out."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    first, second = [(1, 2), (2, 0), (0, 1)][axis]
    found = points.copy()
    found[:, first], found[:, second] = (
        cos * points[:, first] - sin * points[:, second],
        sin * points[:, first] + cos * points[:, second],
    )
    return found


def rest_of(mesh):
    return np.array(mesh.GetPointsAttr().Get(), np.float64)


def quaternion(degrees):
    return Gf.Quatf(Gf.Rotation(Gf.Vec3d(0, 0, 1), float(degrees)).GetQuat())


OPERATIONS = {
    "translate": (lambda prim: prim.AddTranslateOp(), lambda t: Gf.Vec3d(t, 2, -t), lambda p, t: p + np.array([t, 2, -t])),
    "rotateY": (lambda prim: prim.AddRotateYOp(), lambda t: 7.0 * t, lambda p, t: turned(p, 1, 7 * t)),
    "rotateXYZ": (
        lambda prim: prim.AddRotateXYZOp(),
        lambda t: Gf.Vec3f(t, 20, 3 * t),
        lambda p, t: turned(turned(turned(p, 0, t), 1, 20), 2, 3 * t),
    ),
    "scale": (lambda prim: prim.AddScaleOp(), lambda t: Gf.Vec3f(1, 1 + t / 8, 1), lambda p, t: p * [1, 1 + t / 8, 1]),
    "orient": (lambda prim: prim.AddOrientOp(), lambda t: quaternion(9 * t), lambda p, t: turned(p, 2, 9 * t)),
    "transform": (
        lambda prim: prim.AddTransformOp(),
        lambda t: Gf.Matrix4d().SetTranslate(Gf.Vec3d(0, t, 0)),
        lambda p, t: p + np.array([0, t, 0]),
    ),
}


def near(path, expected, **options):
    clip = opened(path, **options)
    assert clip.frame_numbers.tolist() == TIMES.tolist()
    assert np.abs(clip.read(0, len(clip)) - expected).max() < 1e-4
    assert not clip.facts.notes
    return clip


@pytest.mark.parametrize("where", ["mesh", "above", "far above"])
@pytest.mark.parametrize("kind", OPERATIONS)
def test_every_kind_of_transform_moves_the_mesh(tmp_path, kind, where):
    stage, (add, value, moved) = new_stage(tmp_path / "a.usda"), OPERATIONS[kind]
    for path in ("/A", "/A/B"):
        UsdGeom.Xform.Define(stage, path)
    mesh = add_mesh(stage, "/A/B/Head")
    operation = add(UsdGeom.Xformable(stage.GetPrimAtPath({"mesh": "/A/B/Head", "above": "/A/B", "far above": "/A"}[where])))
    for time in TIMES.tolist():
        operation.Set(value(time), time)
    stage.Save()
    near(tmp_path / "a.usda", np.stack([moved(rest_of(mesh), time) for time in TIMES]))


def test_a_pivot_and_a_stack_that_is_reset(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    top, within = UsdGeom.Xform.Define(stage, "/A"), UsdGeom.Xform.Define(stage, "/A/B")
    mesh = add_mesh(stage, "/A/B/Head")
    lost, turn = top.AddTranslateOp(), None
    within.SetResetXformStack(True)
    within.AddTranslateOp(opSuffix="pivot").Set(Gf.Vec3d(1, 2, 3))
    turn = within.AddRotateXOp()
    within.AddTranslateOp(opSuffix="pivot", isInverseOp=True)
    for time in TIMES.tolist():
        turn.Set(5 * time, time)
    for time in (-50.0, 50.0):  # above the reset: neither motion nor frames
        lost.Set(Gf.Vec3d(time, 0, 0), time)
    stage.Save()
    pivot = np.array([1.0, 2, 3])
    near(tmp_path / "a.usda", np.stack([turned(rest_of(mesh) - pivot, 0, 5 * time) + pivot for time in TIMES]))


def test_a_spline_moves_the_mesh_between_its_knots(tmp_path):
    from pxr import Ts

    if not hasattr(Usd.Attribute, "SetSpline"):
        pytest.skip("this usd-core has no splines on attributes")
    stage = new_stage(tmp_path / "a.usda")
    mesh = add_mesh(stage, "/Head")
    spline = Ts.Spline("float")
    for time, value in ((1.0, 0.0), (12.0, 55.0)):
        spline.SetKnot(Ts.Knot(typeName="float", time=time, value=value, nextInterp=Ts.InterpLinear))
    UsdGeom.Xformable(mesh).AddRotateZOp().GetAttr().SetSpline(spline)
    stage.Save()
    clip = opened(tmp_path / "a.usda")
    expected = np.stack([turned(rest_of(mesh), 2, 5 * (time - 1)) for time in TIMES])
    assert clip.frame_numbers.tolist() == TIMES.tolist() and np.abs(clip.read(0, 12) - expected).max() < 1e-4


@pytest.mark.parametrize("kind", ["points", "transform", "nested"])
def test_meshes_within_instances_are_found_and_move(tmp_path, kind):
    stage = new_stage(tmp_path / "a.usda")
    UsdGeom.Xform.Define(stage, "/Proto")
    mesh = add_mesh(stage, "/Proto/Head")
    rest, paths = rest_of(mesh), {"points": "/One", "transform": "/One", "nested": "/Two/One"}
    if kind == "nested":
        UsdGeom.Xform.Define(stage, "/Group")
        stage.DefinePrim("/Group/One").GetReferences().AddInternalReference("/Proto")
        stage.GetPrimAtPath("/Group/One").SetInstanceable(True)
        stage.DefinePrim("/Two").GetReferences().AddInternalReference("/Group")
        stage.GetPrimAtPath("/Two").SetInstanceable(True)
        UsdGeom.Xformable(stage.GetPrimAtPath("/Two")).AddTranslateOp().Set(Gf.Vec3d(0, 0, 5))
    else:
        stage.DefinePrim("/One").GetReferences().AddInternalReference("/Proto")
        stage.GetPrimAtPath("/One").SetInstanceable(True)
    moved = UsdGeom.Xformable(stage.GetPrimAtPath("/One")).AddTranslateOp() if kind == "transform" else mesh.GetPointsAttr()
    for time in TIMES.tolist():
        moved.Set(Gf.Vec3d(time, 0, 0) if kind == "transform" else (rest + np.array([time, 0, 0])).astype(np.float32), time)
    stage.Save()
    assert stage.GetPrimAtPath(f"{paths[kind]}/Head").IsInstanceProxy()
    expected = rest + TIMES[:, None, None] * [1, 0, 0] + [0, 0, 5 * (kind == "nested")]
    clip = near(tmp_path / "a.usda", expected, mesh=f"{paths[kind]}/Head")
    assert "/Proto/Head" in clip.facts.other_meshes


def layer_of_points(path):
    """A layer with points at TIMES."""
    layer = new_stage(path)
    mesh = add_mesh(layer, "/Head")
    rest = rest_of(mesh)
    for time in TIMES.tolist():
        mesh.GetPointsAttr().Set((rest + time).astype(np.float32), time)
    layer.Save()
    return rest


def test_samples_of_layers_that_run_slower_and_later_stand_where_usd_puts_them(tmp_path):
    rest, stage = layer_of_points(tmp_path / "points.usda"), new_stage(tmp_path / "a.usda")
    stage.DefinePrim("/Head", "Mesh").GetReferences().AddReference("./points.usda", "/Head", Sdf.LayerOffset(100, 2))
    stage.Save()
    clip = opened(tmp_path / "a.usda")
    assert clip.frame_numbers.tolist() == list(range(102, 125))
    assert np.abs(clip.read(0, 23) - rest - np.linspace(1, 12, 23)[:, None, None]).max() < 1e-4
    assert clip.facts.notes == ("11 of 23 frames have no sample of their own: USD interpolates them.",)


def test_value_clips_are_played(tmp_path):
    rest, stage = layer_of_points(tmp_path / "points.usda"), new_stage(tmp_path / "a.usda")
    model = Usd.ClipsAPI(add_mesh(stage, "/Head").GetPrim())
    model.SetClipAssetPaths([Sdf.AssetPath("./points.usda")])
    model.SetClipPrimPath("/Head")
    model.SetClipActive([(51, 0)])
    model.SetClipTimes([(51, 1), (62, 12)])
    stage.GetPrimAtPath("/Head").GetAttribute("points").Clear()
    stage.Save()
    clip = opened(tmp_path / "a.usda")
    assert clip.frame_numbers.tolist() == list(range(51, 63))
    assert np.abs(clip.read(0, 12) - rest - TIMES[:, None, None]).max() < 1e-4


def test_a_stage_that_stands_still_is_one_frame_and_says_so(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    mesh = add_mesh(stage, "/Head")
    UsdGeom.Xformable(mesh).AddTranslateOp().Set(Gf.Vec3d(1, 0, 0), 7.0)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(24)
    stage.Save()
    clip = opened(tmp_path / "a.usda")
    assert clip.frame_numbers.tolist() == [1] and np.abs(clip.read(0, 1) - rest_of(mesh) - [1, 0, 0]).max() < 1e-5
    assert clip.facts.notes == ("Nothing moves the mesh: one still frame was read, though the stage says time codes 1 to 24.",)


@pytest.mark.parametrize("name", ["shots [old]/take [1].usda", "дубль=1 (final).usdc", "a'b{2},x#.usda", "%04d.usda"])
def test_names_of_files_and_folders_may_hold_anything(tmp_path, name):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    rest = layer_of_points(path.with_name(f"points {path.name}"))
    stage = new_stage(path)
    stage.DefinePrim("/Head", "Mesh").GetReferences().AddReference(f"./points {path.name}", "/Head")
    stage.Save()
    near(path, rest + TIMES[:, None, None])


def test_layers_that_are_not_there_are_said(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    stage.DefinePrim("/Head", "Mesh").GetReferences().AddReference("./gone.usda", "/Head")
    add_mesh(stage, "/Other")
    stage.Save()
    clip = opened(tmp_path / "a.usda", mesh="Other")
    assert "Layers that it refers to are not there: ./gone.usda" in clip.facts.notes[0]
    (tmp_path / "b.usda").write_text("#usda 1.0\n(subLayers = [@./lost.usda@])\n")
    with pytest.raises(InputError, match=r"b.usda: expected one mesh, and it has none. Layers .*lost.usda"):
        opened(tmp_path / "b.usda")


def test_samples_that_differ_by_rounding_are_one(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    mesh = add_mesh(stage, "/Head")
    slide = UsdGeom.Xformable(mesh).AddTranslateOp()
    rest = rest_of(mesh)
    for time in TIMES.tolist():
        mesh.GetPointsAttr().Set((rest + time).astype(np.float32), time)
        slide.Set(Gf.Vec3d(time, 0, 0), time + 1e-7)
    stage.Save()
    near(tmp_path / "a.usda", rest + TIMES[:, None, None] * [2, 1, 1])


@pytest.mark.parametrize("changes", [False, True])
def test_faces_with_time_samples_may_not_change(tmp_path, changes):
    stage = new_stage(tmp_path / "a.usda")
    mesh = add_mesh(stage, "/mesh")
    points, corners = mesh.GetPointsAttr(), mesh.GetFaceVertexIndicesAttr()
    rest, first = points.Get(), corners.Get()
    points.Clear()
    for time in TIMES.tolist():
        points.Set([point + Gf.Vec3f(time, 0, 0) for point in rest], time)
        corners.Set(list(reversed(first)) if changes and time > 5 else first, time)
    stage.Save()
    clip = opened(tmp_path / "a.usda")
    assert len(clip.read(0, 5)) == 5
    if changes:
        with pytest.raises(InputError, match="other faces at time code 6 than at first"):
            clip.read(5, 6)
    else:
        assert len(clip.read(5, 12)) == 7
