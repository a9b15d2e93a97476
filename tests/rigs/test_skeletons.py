"""Skinned creatures of glTF files: the controls of their joints, and their own clips inverted."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from riginv.errors import InputError
from riginv.geometry.kernels.library import pure_torch
from riginv.rig.contract import check_rig
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.rig.subtree_jacobian import SubtreeJacobian
from riginv.solvers.objective import Objective
from riginv.tracking.surfaces.scan_files import open_scans
from rigs.gltf import GltfRig
from tests.rigs.test_gltf_joints import dancer
from tests.support.clips import reading_options
from tests.support.creatures import CREATURES, Creature, fox, write_creature


@pytest.fixture(scope="module")
def fox_file(tmp_path_factory) -> str:
    return str(write_creature(tmp_path_factory.mktemp("fox") / "fox.glb", fox(), frames=12))


@pytest.fixture(scope="module")
def fox_rig(fox_file) -> GltfRig:
    return GltfRig(fox_file, joints=True)


def random_controls(rig: LinearRig, count: int) -> torch.Tensor:
    draws = torch.rand(count, len(rig.controls), generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    return rig.lower + draws * (rig.upper - rig.lower)


@pytest.mark.parametrize("name", ["fox_rig", "body"])
def test_the_jacobian_is_the_one_of_automatic_differentiation(name, request):
    rig = request.getfixturevalue(name)
    controls = random_controls(rig, 2)
    found, jacobian = rig.coefficient_jacobian(controls)
    expected, by_autograd = LinearRig.coefficient_jacobian(rig, controls)
    assert isinstance(jacobian, SubtreeJacobian) and torch.allclose(found, expected)
    assert torch.allclose(jacobian.dense(), by_autograd.dense(), atol=1e-9 * float(by_autograd.dense().abs().max()))


def test_morph_targets_and_joints_have_it_too(tmp_path):
    rig = GltfRig(dancer(tmp_path / "a.glb", glasses=True), joints=True, joint_translation=True, joint_scale=True)
    controls = random_controls(rig, 3)
    found, jacobian = rig.coefficient_jacobian(controls)
    expected, by_autograd = LinearRig.coefficient_jacobian(rig, controls)
    assert len(rig.targets) == 2 and torch.allclose(found, expected)
    assert torch.allclose(jacobian.dense(), by_autograd.dense(), atol=1e-9 * float(by_autograd.dense().abs().max()))


@pytest.mark.parametrize("name", ["fox_rig", "body"])
def test_products_over_subtrees_are_those_of_the_dense_matrix(name, request):
    rig = request.getfixturevalue(name)
    controls, space = random_controls(rig, 3), RigInMeshSpace(rig, MeshSpace.from_rig(rig))
    metric = Objective(space, dtype=torch.float64).metric
    _, jacobian = rig.coefficient_jacobian(controls)
    some = torch.arange(1, len(rig.controls), 2)
    scale = torch.rand(len(some), dtype=torch.float64)
    chosen, dense = jacobian.of_controls(some).scaled(scale), jacobian.dense()[:, :, some] * scale
    expected = dense.mT @ metric.to_dense() @ dense
    rows = torch.rand(3, 2, dense.shape[1], dtype=torch.float64)
    assert chosen.tree.blocks(metric) is not None
    with pure_torch():
        without_kernels = chosen.gram(metric)
    for found in (chosen.gram(metric), without_kernels):
        assert torch.allclose(found, expected, atol=1e-12 * float(expected.abs().max()))
    assert torch.allclose(chosen.dense(), dense)
    assert torch.allclose(chosen.times_each(rows), rows @ dense)
    assert torch.allclose(chosen.vjp(rows[:, 0]), (rows[:, :1] @ dense)[:, 0])
    _, first = rig.coefficient_jacobian(controls[:1])
    assert torch.allclose(first.times(rows[0]), rows[0] @ first.dense()[0])
    mixed = metric.to_dense() + 0.1 * metric.to_dense().max()  # no metric of skinning: its three axes are not apart
    assert torch.allclose(chosen.gram(mixed), dense.mT @ mixed @ dense)


def test_what_the_animation_does_makes_the_controls(fox_rig):
    names = set(fox_rig.control_names)
    for name, expected in (
        ("hips.tx", True),
        ("tongue1.ty", True),
        ("spine4.sz", True),
        ("spine2.tx", False),
        ("jaw.sx", False),
    ):
        assert (name in names) == expected
    assert not any("_ik_" in name or name.startswith(("head_end", "Armature")) for name in names)
    assert any("5 joints move no vertex" in note and "head_end" in note for note in fox_rig.notes)
    check_rig(fox_rig)


def test_limits_hold_the_animation_and_a_number_replaces_them(fox_file, tmp_path):
    creature = fox()
    creature.turns = 500.0
    rig = GltfRig(str(write_creature(tmp_path / "turning.glb", creature)), joints=True)
    spread = {control.name: control.upper - control.lower for control in rig.controls}
    assert max(spread["hips.rx"], spread["hips.ry"], spread["hips.rz"]) > 500
    assert spread["jaw.rx"] == pytest.approx(120, abs=20)
    fixed = GltfRig(fox_file, joints=True, joint_limit_deg=45, joint_translation=False, joint_scale=False)
    assert {(control.lower, control.upper) for control in fixed.controls} == {(-45.0, 45.0)}
    assert set(fixed.joint_orders.values()) == {"XYZ"}


def test_translations_and_scales_of_all_joints_or_none(fox_file):
    every = GltfRig(fox_file, joints=True, joint_translation=True, joint_scale=True)
    assert len(every.controls) >= 7 * len(every.joint_orders)
    assert len(GltfRig(fox_file, joints=True, joint_translation=False, joint_scale=False).controls) == 3 * len(
        every.joint_orders
    )


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"joint_translation": "some"}, "rig.joint_translation is 'some', expected auto, true or false"),
        ({"joint_scale": 2}, "rig.joint_scale is 2, expected auto, true or false"),
        ({"joint_limit_deg": "wide"}, "rig.joint_limit_deg is 'wide', expected a number above 0, or auto"),
        ({"joint_limit_deg": True}, "rig.joint_limit_deg is True, expected a number above 0, or auto"),
    ],
)
def test_wrong_settings_are_named(fox_file, fields, says):
    with pytest.raises(InputError, match=says):
        GltfRig(fox_file, joints=True, **fields)


def test_an_animation_that_cannot_be_read_is_noted_and_sets_no_limits(fox_file, tmp_path):
    data = Path(fox_file).read_bytes()
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + length])
    document["animations"][0]["channels"][0]["sampler"] = 999
    text = json.dumps(document).encode()
    text = text.ljust(len(text) + -len(text) % 4)
    sizes = (len(data) - length + len(text)).to_bytes(4, "little") + len(text).to_bytes(4, "little")
    (tmp_path / "damaged.glb").write_bytes(data[:8] + sizes + data[16:20] + text + data[20 + length :])
    rig = GltfRig(str(tmp_path / "damaged.glb"), joints=True)
    assert any("Animation 'gait' gives the joints no limits" in note for note in rig.notes)
    assert all(control.unit == "deg" and control.upper == 60 for control in rig.controls)


def inverted(rig: GltfRig, file: str) -> tuple[float, float, torch.Tensor]:
    """Mean error over the mesh's size, the fraction of converged frames, and the controls."""
    from benchmarks.skeletons import invert_file

    found = invert_file(rig, file)
    size = float((rig.rest_vertices.amax(dim=0) - rig.rest_vertices.amin(dim=0)).norm())
    converged = np.mean(["not_converged" not in flags for flags in found.errors.flags])
    assert not any("outside_reach" in flags for flags in found.errors.flags)  # as rounding once said of large creatures
    return float(found.errors.mean_mm.mean()) / size, float(converged), found.controls


@pytest.mark.parametrize("unit", [1.0, 100.0, 0.01])
def test_a_creature_is_recovered_from_its_own_clip_in_any_unit(tmp_path, unit):
    file = str(write_creature(tmp_path / "fox.glb", fox(), frames=20, unit=unit))
    error, converged, controls = inverted(GltfRig(file, joints=True), file)
    assert error < 2e-6 and converged == 1
    assert torch.isfinite(controls).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CREATURES))
def test_creatures_are_recovered_from_their_own_clips(tmp_path, name):
    file = str(write_creature(tmp_path / f"{name}.glb", CREATURES[name]()))
    rig = GltfRig(file, joints=True)
    error, converged, controls = inverted(rig, file)
    assert error < 2e-6 and converged >= 0.99
    angles = controls[:, [control.unit == "deg" for control in rig.controls]]
    assert angles.diff(dim=0).abs().max() < 100  # a leap would be a half or a full turn


def test_a_root_that_turns_several_times_has_a_continuous_curve(tmp_path):
    creature = Creature(turns=900.0, rings=4, around=6)
    body = creature.chain("body", -1, [0, 0, 0], [0, 0.3, 0], 1, 0.1, swing=10)[0]
    creature.chain("arm", body, [0, 0.3, 0], [0.2, 0, 0], 2, 0.05, swing=60)
    file = str(write_creature(tmp_path / "turning.glb", creature, frames=40))
    rig = GltfRig(file, joints=True)
    error, converged, controls = inverted(rig, file)
    assert error < 2e-6 and converged == 1
    turning = controls[:, :3]
    assert turning.diff(dim=0).abs().max() < 60 and (turning[-1] - turning[0]).abs().max() > 800


def test_scans_of_a_rigs_own_file_are_in_its_unit(fox_file):
    rig = GltfRig(fox_file, joints=True, unit_mm=10.0)
    scans = open_scans(fox_file, rig, reading_options())
    assert scans.unit_mm == 10.0 and len(scans) == 12
