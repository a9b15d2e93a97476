"""Angles in every order of the axes, against roma."""

import pytest
import roma
import torch

from riginv.geometry.euler import ORDERS, axis_rotations, continuous_angles, euler_angles


def together(angles: torch.Tensor, orders: torch.Tensor) -> torch.Tensor:
    first, middle, last = axis_rotations(angles, orders)
    return first @ middle @ last


@pytest.mark.parametrize("order", ORDERS)
def test_every_order_is_that_of_roma_and_is_taken_apart_again(order):
    angles = 6 * torch.rand(50, 4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) - 3
    orders = torch.tensor([order] * 4)
    rotations = together(angles, orders)
    expected = roma.euler_to_rotmat("".join("XYZ"[axis] for axis in order), angles[..., list(order)])
    assert torch.allclose(rotations, expected, atol=1e-12)
    found = euler_angles(rotations, orders)
    assert found[..., order[1]].abs().max() <= torch.pi / 2
    assert torch.allclose(together(found, orders), rotations, atol=1e-2)  # near gimbal lock to its threshold
    assert (together(found, orders) - rotations).abs().median() < 1e-12


def test_a_joint_in_gimbal_lock_keeps_its_rotation():
    orders = torch.tensor([ORDERS[0]])
    rotations = together(torch.tensor([[[0.4, torch.pi / 2, 0.7]]], dtype=torch.float64), orders)
    found = euler_angles(rotations, orders)
    assert found[0, 0, 2] == 0 and torch.allclose(together(found, orders), rotations, atol=1e-9)


def test_curves_go_through_full_turns_and_through_gimbal_lock_without_a_jump():
    frames = torch.linspace(0, 1, 200, dtype=torch.float64)
    true = torch.stack([9.0 * frames, 2.6 * frames, -3.0 * frames], dim=1)[:, None]
    orders, far = torch.tensor([ORDERS[0]]), torch.full((1, 3), 20.0, dtype=torch.float64)
    jumping = euler_angles(together(true, orders), orders)
    found = continuous_angles(jumping, orders, -far, far)
    assert jumping.diff(dim=0).abs().max() > 2
    assert torch.allclose(found, true, atol=1e-6)


def test_limits_are_kept_where_a_full_turn_less_does():
    angles = torch.tensor([[[3.0, 0.0, 0.0]], [[-3.1, 0.0, 0.0]]], dtype=torch.float64)
    limit = torch.full((1, 3), torch.pi, dtype=torch.float64)
    found = continuous_angles(angles, torch.tensor([ORDERS[0]]), -limit, limit)
    assert torch.allclose(found, angles)
