"""The body: its size, its contract, its mirror, wrap-around and gimbal lock, its walk, and that everything trains on it."""

import re

import numpy as np
import pytest
import torch

from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.errors import InputError
from riginv.geometry.skinning import skin
from riginv.networks.inverse import StagedInverse
from riginv.rig.batches import generator_at
from riginv.rig.contract import contract
from riginv.sampling.controls import SparseControls
from riginv.tracking.rigs import build_clip
from rigs.body import BodyRig
from rigs.body.build import body_geometry

FLIPPED = re.compile(r"root_(move_x|turn|roll)|(spine\d?|neck|head)_(side|twist)|jaw_side")
SLOW_CLAUSES = "gradients equal"  # on all vertices: half a minute; test_gradients looks at the coefficients instead


def posed(body: BodyRig, **controls: float) -> torch.Tensor:
    values = body.neutral_controls.clone()
    for name, value in controls.items():
        values[body.control_names.index(name)] = value
    return values[None]


def drawn(body: BodyRig, count: int, name: str = "body") -> torch.Tensor:
    share = torch.rand(count, len(body.controls), generator=generator_at(0, name))
    return body.lower + share * (body.upper - body.lower)


def test_it_is_the_body_that_it_says(body):
    assert len(body.rest_vertices) == 13380 and 100 <= len(body.controls) <= 160
    assert len(body.joint_names) == 77 and sum("finger" in name for name in body.joint_names) == 30
    height = body.rest_vertices[:, 1].max() - body.rest_vertices[:, 1].min()
    assert 1600 < height < 1750
    assert {control.unit for control in body.controls} == {"mm", "deg"}
    assert len(body.basis) == 12 * 76  # the root carries no skin


def test_it_keeps_the_contract(body):
    for name, check in contract(body):
        if not name.startswith(SLOW_CLAUSES):
            check()


@pytest.mark.slow
def test_it_keeps_all_of_the_contract(body):
    for _, check in contract(body):
        check()


@pytest.mark.parametrize("pose", ["rest", "random", "half turn", "gimbal"])
def test_gradients(body, pose):
    controls = drawn(body, 1)
    if pose == "rest":
        controls = body.neutral_controls[None]
    elif pose == "half turn":
        controls[0, body.control_names.index("root_turn")] = 180.0
    elif pose == "gimbal":
        controls[0, body.control_names.index("root_pitch")] = 90.0
    controls = controls.double().requires_grad_()
    probes = torch.randn(len(body.basis), 3, generator=generator_at(0, "probes"), dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda values: body.coefficients(values) @ probes / 100, controls, eps=1e-4, atol=1e-5)


def test_the_mesh_is_what_plain_skinning_makes_of_the_joints(body):
    controls = drawn(body, 2)
    geometry = body_geometry()
    matrices = body.coefficients(controls).unflatten(1, (-1, 3, 4)).clone()
    matrices[..., 3] -= torch.einsum("bjrc,jc->bjr", matrices[..., :3], geometry["heads"][body.skinned])
    expected = skin(body.rest_vertices, geometry["weights"][:, body.skinned], matrices)
    torch.testing.assert_close(body(controls), expected, atol=0.01, rtol=0)


def test_an_elbow_bends_by_its_degrees_and_moves_only_what_hangs_on_it(body):
    moved = body(posed(body, left_elbow_bend=60.0))[0]
    distance = (moved - body.rest_vertices).norm(dim=1)
    assert (distance[body.rest_vertices[:, 0] < 100] < 1e-3).all() and distance.max() > 200
    geometry = body_geometry()
    held = geometry["weights"][:, body.joint_names.index("lowerarm01.L")] > 0.999
    before, after = (points[held].double().numpy() for points in (body.rest_vertices, moved))
    before, after = before - before.mean(axis=0), after - after.mean(axis=0)
    u, _, v = np.linalg.svd(after.T @ before)
    assert np.degrees(np.arccos((np.trace(u @ v) - 1) / 2)) == pytest.approx(60, abs=0.1)


def test_macros_and_single_controls_add_up(body):
    together = body(posed(body, spine_bend=25.0))
    alone = body(posed(body, **{f"spine{number}_bend": 5.0 for number in range(1, 6)}))
    torch.testing.assert_close(together, alone, atol=1e-3, rtol=0)


def test_mirrored_controls_give_the_mirrored_mesh(body):
    controls = drawn(body, 2)
    mirrored = torch.empty_like(controls)
    for place, name in enumerate(body.control_names):
        other = name.replace("left_", "#").replace("right_", "left_").replace("#", "right_")
        mirrored[:, body.control_names.index(other)] = controls[:, place] * (-1 if FLIPPED.fullmatch(name) else 1)
    flip = torch.tensor([-1.0, 1.0, 1.0])
    opposite = torch.cdist(body.rest_vertices, body.rest_vertices * flip).argmin(dim=1)
    torch.testing.assert_close(body(mirrored), body(controls)[:, opposite] * flip, atol=0.05, rtol=0)


def test_a_full_turn_is_none(body):
    controls = drawn(body, 2)
    turned = controls.clone()
    turned[:, body.control_names.index("root_turn")] += 360
    torch.testing.assert_close(body(turned), body(controls), atol=0.02, rtol=0)


def test_in_gimbal_lock_turn_and_roll_are_one(body):
    one = body(posed(body, root_pitch=90.0, root_turn=30.0))
    other = body(posed(body, root_pitch=90.0, root_roll=-30.0))
    torch.testing.assert_close(one, other, atol=0.02, rtol=0)


def test_the_features_tell_the_angles_and_take_the_short_way_round(body):
    controls = drawn(body, 4) * 0.5
    features = body.features(body.coefficients(controls))
    hips = features[:, 12:].unflatten(1, (-1, 3))[:, list(body.skinned).index(body.joint_names.index("upperleg01.L")), 0]
    torch.testing.assert_close(torch.rad2deg(-hips), controls[:, body.control_names.index("left_hip_bend")], atol=0.01, rtol=0)
    before, after = (body.features(body.coefficients(posed(body, root_turn=turn))) for turn in (179.0, -179.0))
    assert body.feature_change(before, after)[:, 12:].abs().max() == pytest.approx(np.radians(2), abs=1e-3)


def test_mesh_space_is_exact_and_its_frame_orthonormal(body, body_in_space):
    space = body_in_space.space
    assert space.size == 912
    frame = space.directions.flatten(1)
    assert (frame @ frame.T - torch.eye(912)).abs().max() < 1e-4
    controls = drawn(body, 3)
    torch.testing.assert_close(space.decode(body_in_space(controls)), body(controls), atol=0.02, rtol=0)


def test_the_untrained_inverse_is_accurate_at_half_turns_and_gimbal_lock(body, body_in_space):
    torch.manual_seed(0)
    network = StagedInverse(body_in_space, stages=1, hidden=[8])
    sample = SparseControls(body_in_space).sample(64, generator_at(0, "sample"))
    network.calibrate(body_in_space(sample))
    controls = torch.cat(
        [0.5 * drawn(body, 8)]
        + [posed(body, root_turn=turn, left_hip_bend=30.0) for turn in (-180.0, -179.9, 179.9, 180.0)]
        + [posed(body, root_pitch=pitch, root_roll=20.0, left_knee_bend=40.0) for pitch in (-90.0, 90.0, 89.9)]
    )
    wanted = body_in_space(controls)
    found = network(wanted)
    assert torch.isfinite(found).all() and (found >= body.lower).all() and (found <= body.upper).all()
    errors = ((body_in_space(found) - wanted).square().sum(dim=1) / 13380).sqrt()
    assert errors[8:12].max() < 15  # at the half turn
    assert errors.max() < 120 and errors.median() < 30  # of 600 mm and more for neutral
    assert (network(torch.zeros(1, 912)) == 0).all()


def test_the_walk_walks(body):
    motion = body.motion()
    assert motion.name == "walk" and motion.fps == 60 and motion.vertices.shape == (101, 13380, 3)
    lowest = motion.vertices[:, :, 1].amin(dim=1)
    floor = body.rest_vertices[:, 1].min()
    assert (lowest - floor).abs().max() < 25  # one foot is on the ground
    middle = motion.vertices.mean(dim=1)
    assert middle[-1, 2] - middle[0, 2] > 600 and middle[:, 0].abs().max() < 60
    assert (motion.vertices[1:] - motion.vertices[:-1]).norm(dim=2).max() < 45
    sole = body.rest_vertices[:, 1] < floor + 20
    left, right = (motion.vertices[:, sole & (side * body.rest_vertices[:, 0] > 0), 2].mean(dim=1) for side in (1, -1))
    assert (left - right).max() > 150 and (right - left).max() > 150  # each foot is ahead once


def test_a_motion_that_is_broken_is_refused(body):
    class Broken(BodyRig):
        def motion(self):
            walk = super().motion()
            walk.vertices[7, 3, 1] = torch.nan
            return walk

    with pytest.raises(InputError, match="frame 7 of its motion 'walk' holds NaN"):
        build_clip(None, ReadingOptions(), FrameOptions(), body, Broken())


def test_every_pose_that_has_a_name_is_within_the_limits(body):
    place = {control.name: control for control in body.controls}
    for pose, changes in body.expressions().items():
        for name, value in changes.items():
            assert place[name].lower <= value <= place[name].upper, f"{pose}: {name}"


@pytest.mark.parametrize("model", ["inverse", "holden", "forward"])
def test_every_model_trains_on_it(model, run, few_optima):
    hidden = ["model.network.hidden=[16]", "evaluation.test_poses=8", "trainer.max_steps=3", "data.steps_per_epoch=3"]
    made = run("train", "rig=body", f"model={model}", *hidden, small=True)
    assert made.code == 0, made.text
    assert np.isfinite(made.metrics["rig_poses/mean_vertex_error_mm"])
    assert ("walk/mean_vertex_error_mm" in made.metrics) == (model != "forward")
    assert ("walk/roughness" in made.metrics) == (model != "forward")
