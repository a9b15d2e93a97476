"""Skeletons and blend shapes of USD stages, against usd-core's own baking; skipped where usd-core is not installed."""

import numpy as np
import pytest

from tests.support.usd_stages import (
    Gf,
    Sdf,
    UsdGeom,
    UsdSkel,
    add_animation,
    add_influences,
    add_mesh,
    add_shapes,
    add_skeleton,
    baked,
    character,
    new_stage,
    opened,
)

TIMES = [float(time) for time in range(1001, 1009)]
CLOSE = 1e-3  # mm


def near(path, meshes, times=TIMES, **options):
    """That a stage is read as usd-core bakes it, and moves."""
    clip = opened(path, **options)
    found, expected = clip.read(0, len(clip)), baked(path, meshes, times)
    assert clip.frame_numbers.tolist() == [int(time) for time in times] and clip.facts.meshes == tuple(meshes)
    assert np.abs(found - expected).max() * clip.unit_mm < CLOSE
    assert np.abs(found - found[0]).max() * clip.unit_mm > 1
    return clip


@pytest.mark.parametrize("kind", ["joints", "shapes", "both"])
@pytest.mark.parametrize("method", ["classicLinear", "dualQuaternion"])
def test_joints_and_shapes_are_those_that_usd_bakes(tmp_path, kind, method):
    stage = new_stage(tmp_path / "a.usda")
    UsdSkel.Root.Define(stage, "/Root").AddRotateYOp().Set(20.0)
    skeleton, mesh = add_skeleton(stage, "/Root/Skel"), add_mesh(stage, "/Root/Mesh")
    moves = add_animation(stage, "/Root/Skel/Anim", TIMES)
    UsdSkel.BindingAPI(skeleton).CreateAnimationSourceRel().SetTargets([moves.GetPath()])
    UsdSkel.BindingAPI.Apply(mesh.GetPrim()).CreateSkeletonRel().SetTargets(["/Root/Skel"])
    if kind != "joints":
        add_shapes(mesh)
    if kind != "shapes":
        add_influences(mesh).CreateSkinningMethodAttr(method)
    stage.Save()
    clip = near(tmp_path / "a.usda", ["/Root/Mesh"])
    assert clip.facts.animation == "/Root/Skel/Anim" and not clip.facts.notes and not clip.facts.other_meshes


@pytest.mark.parametrize("weight", [0.25, 0.5, -0.4, 1.5])
def test_shapes_in_between_stand_at_any_weight(tmp_path, weight):
    stage = new_stage(tmp_path / "a.usdc")
    character(stage, "/Root", TIMES)
    add_shapes(UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Mesh0")), inbetween=None)
    between = UsdSkel.BlendShape(stage.GetPrimAtPath("/Root/Mesh0/jaw")).CreateInbetween("other")
    between.SetWeight(weight)
    between.SetOffsets([Gf.Vec3f(0, 3, 1), Gf.Vec3f(1, 0, 0), Gf.Vec3f(0, -2, 0)])
    stage.Save()
    near(tmp_path / "a.usdc", ["/Root/Mesh0"])


def test_a_rigid_mesh_with_its_own_order_of_joints(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    character(stage, "/Root", TIMES, meshes=2)
    rigid = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Mesh1"))
    add_influences(rigid, rigid=True).CreateJointsAttr(["root/neck/head", "root", "root/neck"])
    stage.Save()
    near(tmp_path / "a.usda", ["/Root/Mesh0", "/Root/Mesh1"], mesh=["Mesh1", "Mesh0"])


def test_transforms_above_and_points_that_move_count_beside_the_skin(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    above = UsdGeom.Xform.Define(stage, "/World")
    character(stage, "/World/Root", TIMES, meshes=2)
    slide, turn = above.AddTranslateOp(), UsdGeom.Xformable(stage.GetPrimAtPath("/World/Root/Skel")).AddRotateXYZOp()
    moved = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Root/Mesh0"))
    UsdGeom.Xformable(moved).AddScaleOp().Set(Gf.Vec3f(1, 2, 1))
    rest = np.array(moved.GetPointsAttr().Get())
    for number, time in enumerate(TIMES):
        slide.Set(Gf.Vec3d(number, 0, 2), time)
        turn.Set(Gf.Vec3f(3.0 * number, 0, 10), time)
        moved.GetPointsAttr().Set((rest * (1 + 0.1 * number)).astype(np.float32), time)
    stage.Save()
    near(tmp_path / "a.usda", ["/World/Root/Mesh0", "/World/Root/Mesh1"], mesh=["Mesh0", "Mesh1"])


def test_instances_are_posed_each_by_its_own_animation(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    character(stage, "/Class", TIMES)
    stage.GetPrimAtPath("/Class").SetSpecifier(Sdf.SpecifierClass)
    for number in range(2):
        one = stage.DefinePrim(f"/One{number}")
        one.GetReferences().AddInternalReference("/Class")
        one.SetInstanceable(True)
        moves = add_animation(stage, f"/Anim{number}", TIMES, seed=50 + number)
        UsdSkel.BindingAPI.Apply(one).CreateAnimationSourceRel().SetTargets([moves.GetPath()])
        UsdGeom.Xformable(one).AddTranslateOp().Set(Gf.Vec3d(100 * number, 0, 0))
    stage.Save()
    assert stage.GetPrimAtPath("/One1/Mesh0").IsInstanceProxy()
    for number in range(2):
        clip = near(tmp_path / "a.usda", [f"/One{number}/Mesh0"], mesh=f"/One{number}/Mesh0")
        assert clip.facts.animation == f"/Anim{number}" and clip.facts.other_meshes == (f"/One{1 - number}/Mesh0",)


@pytest.mark.parametrize("kind", ["no schemas", "no root", "no skeleton"])
def test_bindings_that_usd_passes_over_are_mended_and_said(tmp_path, kind):
    stage = new_stage(tmp_path / "good.usda")
    UsdGeom.Xform.Define(stage, "/World")
    character(stage, "/World/Root", TIMES)
    if kind == "no skeleton":
        for name in ("jointIndices", "jointWeights", "geomBindTransform"):
            stage.GetPrimAtPath("/World/Root/Mesh0").RemoveProperty(f"primvars:skel:{name}")
    stage.Save()
    expected = baked(tmp_path / "good.usda", ["/World/Root/Mesh0"], TIMES)
    text = (tmp_path / "good.usda").read_text()
    if kind == "no schemas":
        text = text.replace('prepend apiSchemas = ["SkelBindingAPI"]', "")
    if kind == "no root":
        text = text.replace("def SkelRoot", "def Xform")
    if kind == "no skeleton":
        text = text.replace("rel skel:skeleton = </World/Root/Skel>", "")
    (tmp_path / "bad.usda").write_text(text)
    clip = opened(tmp_path / "bad.usda")
    assert np.abs(clip.read(0, len(TIMES)) - expected).max() * 10 < CLOSE
    (note,) = clip.facts.notes
    assert "/World/Root" in note and "all the same" in note and clip.facts.animation == "/World/Root/Anim"


def test_a_skin_that_usd_cannot_evaluate_is_refused(tmp_path):
    from riginv.errors import InputError

    stage = new_stage(tmp_path / "a.usda")
    character(stage, "/Root", TIMES)
    joints = UsdSkel.BindingAPI(stage.GetPrimAtPath("/Root/Mesh0")).GetJointIndicesPrimvar()
    joints.Set([7] * len(joints.Get()))
    stage.Save()
    with pytest.raises(InputError, match=r"a.usda: .*skin of /Root/Mesh0"):
        opened(tmp_path / "a.usda")
