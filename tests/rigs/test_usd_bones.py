"""Skeletons of USD stages as clips of a rig with joints of the same names; skipped where usd-core is not installed."""

from pathlib import Path

import numpy as np
import pytest
import torch

from riginv.animation import usd
from riginv.clips.open import open_clip
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.errors import InputError
from rigs.body import BodyRig
from tests.support.animations import moving
from tests.support.usd_stages import Gf, SameProcess, Usd, UsdGeom, UsdSkel, Vt, add_animation, add_mesh, add_skeleton

FORMATS = {"usda": "rigs.usd.clip.UsdClip", "usdc": "rigs.usd.clip.UsdClip"}


@pytest.fixture(scope="module")
def take(tmp_path_factory, body: BodyRig) -> tuple[Path, torch.Tensor]:
    """A stage of the body in motion without its mesh, and its controls."""
    animation = moving(body, numbers=torch.arange(6), with_motion=False)
    path = tmp_path_factory.mktemp("take") / "take.usdc"
    usd.write(path, animation)
    stage = Usd.Stage.Open(str(path))
    for prim in [prim.GetPath() for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]:
        stage.RemovePrim(prim)
    bare = path.with_name("bare.usdc")
    stage.GetRootLayer().Export(str(bare))
    return bare, animation.controls


@pytest.fixture
def in_this_process(monkeypatch):
    """Stages are read without worker processes, whose start takes seconds."""
    monkeypatch.setattr("rigs.worker_clip.WorkerPool", SameProcess)
    monkeypatch.setattr("rigs.usd.bones.WorkerPool", SameProcess)


def opened(path: Path, rig, **options):
    clip, notes = open_clip(str(path), rig, ReadingOptions(readers=FORMATS, **options), FrameOptions())
    return clip, clip.vertices(0, len(clip)), notes


def changed(take: Path, folder: Path, change) -> Path:
    """A copy of a stage after a change, which is given its prims by name."""
    path = folder / "changed.usda"
    original = Usd.Stage.Open(str(take))
    original.GetRootLayer().Export(str(path))
    stage = Usd.Stage.Open(str(path))
    change(stage, {prim.GetName(): prim for prim in stage.Traverse()})
    stage.Save()
    return path


def test_joints_move_the_mesh_as_the_controls_did(take, body):
    path, controls = take
    clip, meshes, notes = opened(path, body)
    assert len(clip) == len(controls) and clip.fps == pytest.approx(25)
    assert float((meshes - body(controls)).norm(dim=2).max()) < 0.01  # mm: float32 of centimetres
    said = " ".join(notes)
    assert "The motion of 77 joints, found by name" in said and "A unit of its skeleton is 10 mm" in said


@pytest.mark.usefixtures("in_this_process")
def test_z_up_another_unit_a_moving_root_and_a_prefix_of_names(take, body, tmp_path):
    """The skeleton in metres with z up, whose prim stands the character upright and walks."""

    def change(stage, prims):
        UsdGeom.SetStageUpAxis(stage, "Z")
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        skeleton, moves = UsdSkel.Skeleton(prims["skeleton"]), UsdSkel.Animation(prims["animation"])
        place = UsdGeom.Xformable(stage.GetDefaultPrim())
        walk = place.AddTranslateOp()
        for time in (0.0, 5.0):
            walk.Set(Gf.Vec3d(time / 10, 0, 0), time)
        place.AddRotateXOp().Set(90.0)
        place.AddScaleOp().Set(Gf.Vec3f(0.01))
        for joints in (skeleton.GetJointsAttr(), moves.GetJointsAttr()):
            joints.Set(["/".join(f"mixamorig_{name}" for name in joint.split("/")) for joint in joints.Get()])

    _, plain, _ = opened(take[0], body)
    clip, meshes, notes = opened(changed(take[0], tmp_path, change), body)
    expected = plain + torch.tensor([1.0, 0, 0]) * 100 * torch.arange(6)[:, None, None]
    assert float((meshes - expected).norm(dim=2).max()) < 0.05
    assert clip.units.up == "z" and "1000 mm of the rig's" in " ".join(notes)


@pytest.mark.usefixtures("in_this_process")
def test_a_mesh_that_is_the_rigs_comes_first(tmp_path, body):
    animation = moving(body, numbers=torch.arange(3), with_motion=False)
    usd.write(tmp_path / "whole.usdc", animation)
    clip, meshes, _ = opened(tmp_path / "whole.usdc", body)
    assert clip.sequence.facts.format == "USD"
    assert float((meshes - body(animation.controls)).norm(dim=2).max()) < 0.01


def test_another_mesh_gives_way_to_the_skeleton(take, body, tmp_path):
    path = changed(take[0], tmp_path, lambda stage, prims: add_mesh(stage, "/prop"))
    clip, meshes, _ = opened(path, body)
    assert clip.sequence.facts.format == "USD, joints"
    assert torch.equal(meshes, opened(take[0], body)[1])


@pytest.mark.usefixtures("in_this_process")
def test_an_animation_that_is_not_bound_is_bound_and_said(take, body, tmp_path):
    def change(stage, prims):
        UsdSkel.BindingAPI(prims["skeleton"]).GetAnimationSourceRel().ClearTargets(True)

    path = changed(take[0], tmp_path, change)
    _, meshes, notes = opened(path, body)
    assert torch.equal(meshes, opened(take[0], body)[1])
    assert any("binds /body/animation to no skeleton" in note for note in notes)


def unbound_twice(stage, prims):
    UsdSkel.BindingAPI(prims["skeleton"]).GetAnimationSourceRel().ClearTargets(True)
    other = UsdSkel.Animation.Define(stage, "/body/other")
    other.CreateJointsAttr(UsdSkel.Animation(prims["animation"]).GetJointsAttr().Get())


def two_characters(stage, prims):
    add_skeleton(stage, "/second")
    add_animation(stage, "/moves", [0.0, 1.0])
    UsdSkel.BindingAPI(stage.GetPrimAtPath("/second")).CreateAnimationSourceRel().SetTargets(["/moves"])


def without_samples(stage, prims):
    for name in ("translations", "rotations", "scales"):
        prims["animation"].GetAttribute(name).Clear()


def renamed(stage, prims):
    skeleton, moves = UsdSkel.Skeleton(prims["skeleton"]), UsdSkel.Animation(prims["animation"])
    for joints in (skeleton.GetJointsAttr(), moves.GetJointsAttr()):
        joints.Set(["/".join(f"{name}x" for name in joint.split("/")) for joint in joints.Get()])


def not_finite(stage, prims):
    translations = UsdSkel.Animation(prims["animation"]).GetTranslationsAttr()
    values = np.array(translations.Get(2.0))
    values[5] = np.nan
    translations.Set(Vt.Vec3fArray.FromNumpy(values), 2.0)


def without_rest(stage, prims):
    skeleton = UsdSkel.Skeleton(prims["skeleton"])
    skeleton.GetRestTransformsAttr().Clear()
    skeleton.GetBindTransformsAttr().Set(Vt.Matrix4dArray(3, Gf.Matrix4d(1)))


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda stage, prims: stage.RemovePrim(prims["skeleton"].GetPath()), "SkelAnimations and no Skeleton"),
        (unbound_twice, "2 SkelAnimations have its joints .*: choose with reading.animation=NAME"),
        (two_characters, "2 of its skeletons are animated, expected one: choose with reading.animation=NAME"),
        (without_samples, "has no time samples of joints"),
        (renamed, "expected at least half: rename them"),
        (not_finite, "are no finite numbers: damaged"),
        (without_rest, "neither bindTransforms nor restTransforms of its 77 joints"),
    ],
)
def test_unusable_stages_are_one_sentence(take, body, tmp_path, change, says):
    path = changed(take[0], tmp_path, change)
    with pytest.raises(InputError, match=says) as refused:
        opened(path, body)
    assert str(refused.value).startswith(str(path)) and "\n" not in str(refused.value)


@pytest.mark.usefixtures("in_this_process")
def test_one_of_two_animated_skeletons_is_chosen(take, body, tmp_path):
    _, meshes, _ = opened(changed(take[0], tmp_path, two_characters), body, animation="animation")
    assert torch.equal(meshes, opened(take[0], body)[1])
