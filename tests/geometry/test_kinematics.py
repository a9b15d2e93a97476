"""Forward kinematics against plain NumPy, joint by joint."""

import numpy as np
import pytest
import roma
import torch

from riginv.errors import InputError
from riginv.geometry.kinematics import compose, forward_kinematics, invert, transform_from, tree_levels

PARENTS = [2, 0, -1, 2, 1, -1, 5, 4]  # children before parents, and two roots


def random_transforms(*shape: int, scale: bool = False) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    rotations = roma.random_rotmat(shape, dtype=torch.float64, generator=generator)
    factor = 0.5 + torch.rand(*shape, 1, 3, generator=generator, dtype=torch.float64) if scale else 1.0
    return transform_from(rotations * factor, torch.randn(*shape, 3, generator=generator, dtype=torch.float64))


def as_4x4(transform: np.ndarray) -> np.ndarray:
    return np.vstack([transform, [0, 0, 0, 1]])


def test_levels_are_depths():
    assert [level.tolist() for level in tree_levels(PARENTS)] == [[2, 5], [0, 3, 6], [1], [4], [7]]


def test_world_transforms_are_products_up_the_tree():
    local = random_transforms(3, len(PARENTS), scale=True)
    found = forward_kinematics(local, PARENTS)
    for pose in range(3):
        for joint in range(len(PARENTS)):
            expected, at = np.eye(4), joint
            while at >= 0:
                expected = as_4x4(local[pose, at].numpy()) @ expected
                at = PARENTS[at]
            assert np.allclose(found[pose, joint].numpy(), expected[:3], atol=1e-12)


def test_gradients_pass():
    parents = [1, -1, 0]
    local = random_transforms(2, 3).requires_grad_()
    assert torch.autograd.gradcheck(lambda values: forward_kinematics(values, parents), local)


def test_inverse_undoes_scale_and_shear():
    transforms = random_transforms(5, scale=True)
    transforms[:, 0, 1] += 0.4
    expected = torch.eye(4, dtype=torch.float64)[:3].expand(5, 3, 4)
    assert torch.allclose(compose(transforms, invert(transforms)), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("parents", "parts"),
    [
        ([1, 2, 1, -1], ["'b' -> 'c' -> 'b'", "cycle"]),
        ([0], ["'a' -> 'a'"]),
        ([-1, 7], ["'b'", "parent number 7", "0 to 1"]),
        ([-2], ["'a'", "parent number -2"]),
        ([], ["at least one joint"]),
    ],
)
def test_what_is_not_a_tree_is_named(parents, parts):
    with pytest.raises(InputError) as raised:
        tree_levels(parents, "abcd"[: len(parents)])
    assert all(part in str(raised.value) for part in parts), raised.value
