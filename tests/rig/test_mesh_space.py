"""Mesh space: exactness, and that training there is training on full meshes."""

import pytest
import torch

from riginv.errors import InputError
from riginv.rig.contract import random_controls
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.training.losses import SquaredVertexLoss, root_mean_square_mm
from tests.support.toys import ToyRig


def test_the_frame_is_orthonormal_and_spans_the_basis(face_in_space):
    space, rig = face_in_space.space, face_in_space.source
    frame = space.directions.flatten(1).double()
    assert space.size <= 628
    torch.testing.assert_close(frame @ frame.T, torch.eye(space.size, dtype=torch.float64), atol=1e-5, rtol=0)
    rebuilt = face_in_space.linear_map @ space.directions.flatten(1)
    assert (rebuilt - rig.basis.flatten(1)).abs().max() < 1e-3


def test_the_space_of_a_rig_is_computed_once_while_it_is_used():
    rig = ToyRig()
    space = MeshSpace.from_rig(rig)
    assert MeshSpace.from_rig(rig) is space and MeshSpace.from_rig(ToyRig()) is not space
    rig.basis = 2 * rig.basis
    assert MeshSpace.from_rig(rig) is not space
    rig = rig.double()
    assert MeshSpace.from_rig(rig).directions.dtype == torch.float64


def test_meshes_of_the_rig_are_kept_whole(face_in_space):
    controls = random_controls(face_in_space.source, 6, seed=0)
    vertices = face_in_space.source(controls)
    coordinates = face_in_space.space.encode(vertices)
    torch.testing.assert_close(face_in_space.space.decode(coordinates), vertices, atol=2e-3, rtol=0)
    torch.testing.assert_close(coordinates, face_in_space(controls), atol=2e-3, rtol=1e-5)
    assert face_in_space(face_in_space.source.neutral_controls[None]).abs().max() == 0


def test_loss_and_gradient_equal_those_of_full_meshes_constant_aside():
    rig = ToyRig().double()
    in_space = RigInMeshSpace(rig, MeshSpace.from_rig(rig))
    generator = torch.Generator().manual_seed(0)
    targets = rig.rest_vertices + torch.randn(2, 5, 162, 3, generator=generator, dtype=torch.float64) * 3  # mostly out of reach
    controls = random_controls(rig, 5, seed=1).double()
    full, small, gradients = [], [], []
    for target in targets:
        for loss_of in (
            lambda values, target=target: (rig(values) - target).square().mean(),
            lambda values, target=target: SquaredVertexLoss(162)(in_space(values), in_space.space.encode(target)),
        ):
            values = controls.clone().requires_grad_()
            loss = loss_of(values)
            loss.backward()
            (full if len(full) == len(small) else small).append(loss.detach())
            gradients.append(values.grad)
    torch.testing.assert_close(gradients[0], gradients[1], rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(gradients[2], gradients[3], rtol=1e-9, atol=1e-12)
    other = random_controls(rig, 5, seed=2).double()
    for number, target in enumerate(targets):
        moved_full = (rig(other) - target).square().mean() - full[number]
        moved_small = SquaredVertexLoss(162)(in_space(other), in_space.space.encode(target)) - small[number]
        torch.testing.assert_close(moved_full, moved_small, rtol=1e-9, atol=1e-12)


def test_distances_in_mesh_coordinates_are_distances_of_vertices(face_in_space):
    controls = random_controls(face_in_space.source, 4, seed=3)
    one, other = face_in_space.source(controls[:2]), face_in_space.source(controls[2:])
    expected = (one - other).square().sum(dim=2).mean().sqrt()
    found = root_mean_square_mm(face_in_space.space.encode(one), face_in_space.space.encode(other), 8447)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=0)


def test_a_space_fitted_to_samples_keeps_the_residual_that_was_asked_for():
    rig = ToyRig()
    samples = rig(random_controls(rig, 60, seed=0))
    exact = MeshSpace.from_samples(rig.rest_vertices, samples, residual_mm=1e-4)
    rough = MeshSpace.from_samples(rig.rest_vertices, samples, residual_mm=0.5)
    assert rough.size < exact.size <= 12
    for space, most in ((exact, 1e-4), (rough, 0.5)):
        away = (space.decode(space.encode(samples)) - samples).norm(dim=2).mean()
        assert away <= most + 1e-4
        assert space.residual_mm == pytest.approx(float(away), abs=1e-4)


def test_samples_that_make_no_space_are_refused():
    rest = torch.zeros(5, 3)
    with pytest.raises(InputError, match="at least one"):
        MeshSpace.from_samples(rest, torch.zeros(0, 5, 3), 0.1)
    with pytest.raises(InputError, match="NaN"):
        MeshSpace.from_samples(rest, torch.full((2, 5, 3), torch.nan), 0.1)
    with pytest.raises(InputError, match="residual_mm is 0"):
        MeshSpace.from_samples(rest, torch.zeros(2, 5, 3), 0)
