"""Skinning, directly and as a basis, against plain NumPy, vertex by vertex."""

import numpy as np
import pytest
import torch

from riginv.errors import InputError
from riginv.geometry.skinning import check_weights, skin, skinning_basis

VERTICES, JOINTS, POSES = 7, 4, 3


@pytest.fixture
def drawn() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(5)
    rest = torch.randn(VERTICES, 3, generator=generator, dtype=torch.float64)
    weights = torch.rand(VERTICES, JOINTS, generator=generator, dtype=torch.float64)
    matrices = torch.randn(POSES, JOINTS, 3, 4, generator=generator, dtype=torch.float64)
    return rest, weights / weights.sum(dim=1, keepdim=True), matrices


def expected(rest: np.ndarray, weights: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    result = np.zeros((POSES, VERTICES, 3))
    for pose, vertex, joint in np.ndindex(POSES, VERTICES, JOINTS):
        result[pose, vertex] += weights[vertex, joint] * matrices[pose, joint] @ [*rest[vertex], 1]
    return result


def test_skin(drawn):
    assert np.allclose(skin(*drawn).numpy(), expected(*(values.numpy() for values in drawn)), atol=1e-12)


def test_basis_times_the_matrices(drawn):
    rest, weights, matrices = drawn
    basis = skinning_basis(rest, weights)
    assert basis.shape == (12 * JOINTS, VERTICES, 3)
    found = torch.einsum("bk,kva->bva", matrices.flatten(1), basis)
    assert np.allclose(found.numpy(), expected(*(values.numpy() for values in drawn)), atol=1e-12)


def test_basis_about_centres(drawn):
    rest, weights, matrices = drawn
    centres = rest[:JOINTS] + 2
    about = matrices.clone()
    about[..., 3] += torch.einsum("bjrc,jc->bjr", matrices[..., :3], centres)  # where each centre goes
    found = torch.einsum("bk,kva->bva", about.flatten(1), skinning_basis(rest, weights, centres))
    assert np.allclose(found.numpy(), expected(*(values.numpy() for values in drawn)), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ((2, 1, -0.25), ["vertex 2", "'hip'", "negative (-0.25)"]),
        ((3, 0, float("nan")), ["vertex 3", "'root'", "not finite (nan)"]),
        ((4, 2, float("inf")), ["vertex 4", "'knee'", "not finite (inf)"]),
    ],
)
def test_a_wrong_weight_is_named(change, parts, drawn):
    weights = drawn[1].clone()
    weights[change[0], change[1]] = change[2]
    with pytest.raises(InputError) as raised:
        check_weights(weights, "body.glb", ["root", "hip", "knee", "toe"])
    assert all(part in str(raised.value) for part in ["body.glb", *parts]), raised.value


def test_unnormalised_weights_are_named_with_their_sum(drawn):
    weights = drawn[1].clone()
    weights[[1, 5]] *= 1.5
    check_weights(drawn[1], "body.glb")
    with pytest.raises(InputError, match=r"body\.glb: the skin weights of 2 vertices do not sum to 1, .* vertex 1 with 1\.5"):
        check_weights(weights, "body.glb")
