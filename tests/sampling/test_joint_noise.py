"""Poses whose joints turn as no control turns them."""

import pytest
import torch

from riginv.errors import InputError
from riginv.rig.batches import generator_at
from riginv.sampling.controls import SparseControls
from riginv.sampling.joint_noise import JointNoisePoses, random_joint_noise
from riginv.sampling.meshes import select_for_rig
from tests.support.toys import ToyRig

COUNT = 2000


def generator() -> torch.Generator:
    return generator_at(0, "loose")


def test_no_looseness_is_the_pose_itself(body):
    controls = body.lower + 0.3 * (body.upper - body.lower)
    still = body.coefficients_with_joint_noise(controls[None], torch.zeros(1, len(body.joint_noise)))
    assert torch.equal(still, body.coefficients(controls[None]))


def test_a_part_turns_its_own_joint_by_its_angle_and_what_hangs_on_it(body):
    joint = body.joint_names.index("wrist.L")
    parts = torch.zeros(1, len(body.joint_noise))
    parts[0, 3 * joint + 2] = 0.2
    neutral = body.neutral_controls[None]
    before, after = (
        one.unflatten(1, (-1, 3, 4)) for one in (body.coefficients(neutral), body.coefficients_with_joint_noise(neutral, parts))
    )
    place = list(body.skinned).index(joint)
    turn = (after[0, place, :, :3] @ before[0, place, :, :3].T).trace()
    assert float(torch.acos((turn - 1) / 2)) == pytest.approx(0.2, abs=1e-3)
    moved = {body.joint_names[int(body.skinned[row])] for row in (after - before).abs().amax(dim=(0, 2, 3)).gt(1e-5).nonzero()}
    hand = {name for name in body.joint_names if name.endswith(".L") and name.startswith(("wrist", "finger", "meta"))}
    assert moved == hand


def test_parts_go_as_far_as_they_are_said_to_and_the_root_goes_nowhere(body):
    parts = random_joint_noise(body, COUNT, generator())
    deviation = parts.square().mean(dim=0).sqrt() / body.joint_noise.clamp_min(1e-9)
    used = body.joint_noise > 0
    assert (deviation[used] > 0.1).all() and (deviation[used] < 0.5).all()  # few move, most faintly
    assert (parts[:, ~used] == 0).all() and int((~used).sum()) == 3
    assert torch.equal(random_joint_noise(body, COUNT, generator(), strength=2.0), 2 * parts)
    active = parts.ne(0).sum(dim=1).float()
    assert active.min() <= 1 and active.max() > 150 and active.median() < 40


def test_the_meshes_are_near_poses_but_not_among_them(body, body_in_space):
    sampler = JointNoisePoses(body_in_space, SparseControls(body_in_space))
    loose = sampler.sample(200, generator())["coordinates"]
    exact = body_in_space(SparseControls(body_in_space).sample(200, generator()))
    away = (loose - exact).square().sum(dim=1).div(len(body.rest_vertices)).sqrt()
    assert 2 < away.median() < 60 and (away > 0).all()


def test_rigs_without_loose_parts_are_refused_and_left_out_of_mixtures(toy):
    with pytest.raises(InputError, match="rig 'toy' has no joint noise"):
        JointNoisePoses(toy, SparseControls(toy))
    part = {"_target_": "riginv.sampling.joint_noise.JointNoisePoses"}
    other = {"_target_": "riginv.sampling.meshes.RigPoses"}
    mixture = {"samplers": {"loose": part, "poses": other}, "fractions": {"loose": 1, "poses": 1}}
    assert list(select_for_rig(mixture, ToyRig())["samplers"]) == ["poses"]


def test_a_strength_of_nothing_is_refused(body_in_space):
    with pytest.raises(InputError, match="strength is 0"):
        JointNoisePoses(body_in_space, SparseControls(body_in_space), strength=0)
