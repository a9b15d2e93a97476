"""Which meshes and animations of a stage are read, and what is said of the others; skipped where usd-core is not installed."""

import itertools

import numpy as np
import pytest

from riginv.errors import InputError
from tests.support.usd_stages import (
    JOINTS,
    Gf,
    Sdf,
    Usd,
    UsdGeom,
    UsdSkel,
    add_animation,
    add_mesh,
    baked,
    character,
    new_stage,
    opened,
)

TIMES = [1.0, 2.0, 3.0, 4.0]


def moved(stage, path, vertices=30, seed=0, by=1.0):
    mesh = add_mesh(stage, path, vertices, seed)
    rest = np.array(mesh.GetPointsAttr().Get())
    for time in TIMES:
        mesh.GetPointsAttr().Set((rest + by * time).astype(np.float32), time)
    return mesh


@pytest.fixture
def crowd(tmp_path):
    """Two meshes that move, one whose samples are all alike, and one without any."""
    stage = new_stage(tmp_path / "a.usda")
    for name in ("Group", "Group/Skin"):
        UsdGeom.Xform.Define(stage, f"/{name}")
    moved(stage, "/Group/Skin/SkinShape", 30)
    moved(stage, "/Group/Teeth", 20, seed=1)
    moved(stage, "/Group/Collar", 15, seed=2, by=0.0)
    add_mesh(stage, "/Group/Hat", 12)
    stage.Save()
    return tmp_path / "a.usda"


@pytest.mark.parametrize(
    ("names", "read"),
    [
        ("Teeth", ["/Group/Teeth"]),
        ("/Group/Teeth", ["/Group/Teeth"]),
        ("Skin", ["/Group/Skin/SkinShape"]),  # the prim that holds it, as users of Blender and Maya know it
        (["Teeth", "SkinShape"], ["/Group/Skin/SkinShape", "/Group/Teeth"]),
        (["Hat", "/Group/Collar"], ["/Group/Collar", "/Group/Hat"]),
    ],
)
def test_meshes_are_named_by_path_or_name_and_read_in_the_order_of_the_stage(crowd, names, read):
    clip = opened(crowd, mesh=names)
    assert list(clip.facts.meshes) == read and len(clip.facts.other_meshes) == 4 - len(read)
    stage = Usd.Stage.Open(str(crowd))
    points = [np.array(UsdGeom.Mesh(stage.GetPrimAtPath(path)).GetPointsAttr().Get(TIMES[-1])) for path in read]
    assert np.abs(clip.read(3, 4)[0] - np.concatenate(points)).max() < 1e-5
    sizes = np.cumsum([0] + [len(one) for one in points])
    for first, last in itertools.pairwise(sizes.tolist()):
        own = clip.faces.corners[(clip.faces.corners >= first) & (clip.faces.corners < last)] - first
        assert len(own) == 3 * (last - first - 2) and own.max() == last - first - 1


def test_what_is_meant_follows_from_what_moves_and_from_the_rig(crowd):
    with pytest.raises(
        InputError, match=r"expected one mesh, .*those that move are: /Group/Skin/SkinShape \(30 vertices\), /Group/T"
    ):
        opened(crowd)
    for vertices, read in (
        (20, ["Teeth"]),
        (50, ["Skin/SkinShape", "Teeth"]),
        (77, ["Skin/SkinShape", "Teeth", "Collar", "Hat"]),
    ):
        clip = opened(crowd, vertices)
        assert list(clip.facts.meshes) == [f"/Group/{name}" for name in read]
        assert any(f"the rig's {vertices} vertices" in note for note in clip.facts.notes) == (vertices != 77)
    with pytest.raises(InputError, match="expected one mesh"):
        opened(crowd, 49)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ("Nose", "reading.mesh=Nose names 0 of them"),
        ("Group", "reading.mesh=Group names 4 of them"),
        (["Teeth", "Nose"], "names 0 of them"),
    ],
)
def test_names_that_fit_none_or_several_are_refused_with_the_list(crowd, names, said):
    with pytest.raises(InputError, match=rf"a.usda: .*{said}.*SkinShape"):
        opened(crowd, mesh=names)


@pytest.mark.parametrize("kind", ["guide", "proxy", "invisible", "instancer", "sampled alike"])
def test_what_is_not_drawn_is_not_meant(tmp_path, kind):
    stage = new_stage(tmp_path / "a.usda")
    moved(stage, "/Head")
    parent = UsdGeom.PointInstancer.Define(stage, "/Other") if kind == "instancer" else UsdGeom.Xform.Define(stage, "/Other")
    moved(stage, "/Other/Head", by=0.0 if kind == "sampled alike" else 1.0)
    if kind in ("guide", "proxy"):
        parent.CreatePurposeAttr(kind)
    if kind == "invisible":
        parent.CreateVisibilityAttr("invisible")
    stage.Save()
    clip = opened(tmp_path / "a.usda")
    assert clip.facts.meshes == ("/Head",) and clip.facts.other_meshes == ("/Other/Head",)
    assert opened(tmp_path / "a.usda", mesh="/Other/Head").facts.other_meshes == ("/Head",)


def test_frames_in_which_a_mesh_is_hidden_are_said_and_read(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    visible = moved(stage, "/Head").CreateVisibilityAttr()
    for time, value in ((1, "inherited"), (3, "invisible")):
        visible.Set(value, time)
    stage.Save()
    clip = opened(tmp_path / "a.usda")
    assert len(clip) == 4 and "/Head is invisible in 2 frames, the first at time code 3" in clip.facts.notes[0]


@pytest.fixture
def dancer(tmp_path):
    """A character with three animations of one skeleton, of which the first is bound."""
    stage = new_stage(tmp_path / "a.usda")
    character(stage, "/Root", TIMES)
    for number, name in enumerate(("Walk", "Run")):
        add_animation(stage, f"/Root/{name}", TIMES, seed=30 + number)
    other = UsdSkel.Animation.Define(stage, "/Elsewhere")
    other.CreateJointsAttr(["wheel"])
    stage.Save()
    return tmp_path / "a.usda"


def test_animations_that_were_not_read_are_named(dancer):
    clip = opened(dancer)
    assert clip.facts.animation == "/Root/Anim"
    assert clip.facts.other_animations == ("/Root/Walk", "/Root/Run", "/Elsewhere")
    assert "/Root/Run" in clip.facts.notes[0] and "reading.animation=NAME" in clip.facts.notes[0]


@pytest.mark.parametrize(("asked", "read"), [("Run", "Run"), ("/Root/Walk", "Walk"), (2, "Walk"), ("3", "Run"), (1, "Anim")])
def test_an_animation_is_chosen_by_name_path_or_number(dancer, asked, read):
    before, stage = dancer.read_bytes(), Usd.Stage.Open(str(dancer))
    UsdSkel.BindingAPI(stage.GetPrimAtPath("/Root")).GetAnimationSourceRel().SetTargets([f"/Root/{read}"])
    expected = dancer.with_name("expected.usda")
    stage.Export(str(expected))
    clip = opened(dancer, animation=asked)
    assert clip.facts.animation == f"/Root/{read}" and f"/Root/{read}" not in clip.facts.other_animations
    assert np.abs(clip.read(0, 4) - baked(expected, ["/Root/Mesh0"], TIMES)).max() < 1e-4
    assert dancer.read_bytes() == before


@pytest.mark.parametrize(
    ("asked", "said"),
    [("Jump", "names 0 of its SkelAnimations.*/Root/Walk"), (9, "names 0"), ("Elsewhere", "no joint or blend shape")],
)
def test_animations_that_do_not_fit_are_refused(dancer, asked, said):
    with pytest.raises(InputError, match=rf"a.usda: reading.animation={asked}.*{said}"):
        opened(dancer, animation=asked)


def test_a_skeleton_without_animation_stays_at_rest_and_says_so(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    character(stage, "/Root", TIMES)
    stage.GetPrimAtPath("/Root").RemoveProperty("skel:animationSource")
    stage.Save()
    clip = opened(tmp_path / "a.usda")
    assert len(clip) == 1 and clip.facts.animation == ""
    assert any("bound to no SkelAnimation" in note and "/Root/Anim" in note for note in clip.facts.notes)
    assert opened(tmp_path / "a.usda", animation="Anim").frame_numbers.tolist() == [1, 2, 3, 4]


def test_an_animation_within_an_instance_is_named_as_part_of_it(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    character(stage, "/Proto", TIMES)
    stage.GetPrimAtPath("/Proto").SetSpecifier(Sdf.SpecifierClass)
    for name in "AB":
        one = stage.DefinePrim(f"/{name}")
        one.GetReferences().AddInternalReference("/Proto")
        one.SetInstanceable(True)
    stage.Save()
    facts = opened(tmp_path / "a.usda", mesh="/B/Mesh0").facts
    assert (facts.animation, facts.other_animations) == ("/B/Anim", ("/A/Anim",)) and facts.other_meshes == ("/A/Mesh0",)


def test_an_instance_gets_an_animation_of_its_own(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    character(stage, "/Proto", TIMES)
    stage.GetPrimAtPath("/Proto").RemoveProperty("skel:animationSource")
    one = stage.DefinePrim("/One")
    one.GetReferences().AddInternalReference("/Proto")
    one.SetInstanceable(True)
    stage.Save()
    clip = opened(tmp_path / "a.usda", mesh="/One/Mesh0", animation="/One/Anim")
    assert len(clip) == 4 and clip.facts.animation == "/One/Anim" and len(JOINTS) == 3


def test_variants_that_the_stage_does_not_select_are_named(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    variants = UsdGeom.Xform.Define(stage, "/Head").GetPrim().GetVariantSets().AddVariantSet("take")
    for number, name in enumerate(("calm", "angry")):
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        with variants.GetVariantEditContext():
            UsdGeom.Xformable(stage.GetPrimAtPath("/Head")).AddTranslateOp().Set(Gf.Vec3d(number, 0, 0))
    moved(stage, "/Head/Skin")
    stage.Save()
    clip = opened(tmp_path / "a.usda")
    assert clip.facts.notes == ("Of variant set /Head{take} the stage selects 'angry', which was read, not calm.",)
