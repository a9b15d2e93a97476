"""Encoding by way of a sparse basis against the dense projection in float64."""

import copy

import pytest
import torch

from riginv.geometry.distances import frame_distances
from riginv.geometry.kernels.library import kernels, pure_torch
from riginv.geometry.kinematics import apply_motion, remove_motion
from riginv.inference.inverse import QuickEncoder
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.rig.sparse_encoder import SparseEncoder
from riginv.sampling.meshes import random_weights

pytestmark = pytest.mark.skipif(kernels() is None, reason="there are no compiled kernels here: no C compiler")
TOLERANCE = 2e-5  # 0.00004 mm, root mean square, where vertices are moved by 2 mm


@pytest.fixture(scope="module")
def encoder(face_in_space) -> SparseEncoder:
    found = SparseEncoder.for_rig(face_in_space)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def meshes(face_in_space) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    weights = random_weights(len(face_in_space.linear_map), 37, generator)
    posed = face_in_space.source.rest_vertices + (weights @ face_in_space.source.basis.flatten(1)).unflatten(1, (-1, 3))
    return posed + 0.1 * torch.randn(posed.shape, generator=generator)  # which no control makes


def difference(rig: RigInMeshSpace, coordinates: torch.Tensor, meshes: torch.Tensor) -> float:
    """How far coordinates of meshes are from the dense projection in float64, relative to its size, at most."""
    space = rig.space
    exact = (meshes.double() - space.rest_vertices).flatten(1) @ space.directions.flatten(1).double().T
    return float(((coordinates - exact).norm(dim=1) / exact.norm(dim=1)).max())


def test_coordinates_equal_the_dense_projection(face_in_space, encoder, meshes):
    rest = face_in_space.space.rest_vertices
    for given in (meshes[:1], meshes[:2], meshes):
        assert difference(face_in_space, encoder(rest, given), given) < TOLERANCE
    assert torch.equal(copy.deepcopy(encoder)(rest, meshes), encoder(rest, meshes))
    assert torch.equal(encoder(rest, rest[None]), torch.zeros(1, face_in_space.space.size))


def test_products_of_a_mesh_do_not_depend_on_the_batch(face_in_space, encoder, meshes):
    rest = face_in_space.space.rest_vertices
    every = encoder.basis.products(rest, meshes)
    for rows in (slice(0, 1), slice(3, 5), slice(30, 37)):
        assert torch.equal(encoder.basis.products(rest, meshes[rows]), every[rows])


def test_rigid_motion_is_removed_first(face_in_space, encoder, meshes):
    motion = torch.eye(4).repeat(len(meshes), 1, 1)
    motion[:, :3, :3] = torch.linalg.qr(torch.randn(len(meshes), 3, 3, generator=torch.Generator().manual_seed(1)))[0]
    motion[:, :3, 3] = 10.0
    moved = apply_motion(motion, meshes)
    found = encoder(face_in_space.space.rest_vertices, moved, motion)
    assert difference(face_in_space, found, remove_motion(motion.double(), moved.double())) < TOLERANCE


def test_an_unknown_vertex_leaves_no_coordinate(face_in_space, encoder, meshes):
    given = meshes[:2].clone()
    given[1, 17] = torch.nan
    assert encoder(face_in_space.space.rest_vertices, given).isnan().all(dim=1).tolist() == [False, True]


def test_it_serves_only_where_it_pays_and_is_exact(face_in_space, toy, meshes):
    space = face_in_space.space
    assert SparseEncoder.for_rig(toy) is None  # small
    other = MeshSpace(
        space.rest_vertices, torch.linalg.qr(torch.randn(space.rest_vertices.numel(), space.size))[0].T.unflatten(1, (-1, 3))
    )
    assert SparseEncoder.for_rig(RigInMeshSpace(face_in_space.source, other)) is None  # the basis spans something else
    with pure_torch():
        assert torch.equal(QuickEncoder(face_in_space, rounded=False)(meshes), space.encode(meshes))


def test_meshes_of_a_rig_equal_the_dense_ones(face_in_space, encoder):
    rig, generator = face_in_space.source, torch.Generator().manual_seed(2)
    controls = rig.lower + torch.rand(11, len(rig.controls), generator=generator) * (rig.upper - rig.lower)
    change = rig.coefficients(controls) - rig.neutral_coefficients()
    assert (encoder.basis.vertices(rig.rest_vertices, change) - rig(controls)).abs().max() < 1e-4  # mm, of 200
    assert encoder.basis.vertices(rig.rest_vertices, change[:0]).shape == (0, *rig.rest_vertices.shape)


def test_one_pass_measures_what_single_ones_do(face_in_space, encoder, meshes):
    rig, generator = face_in_space.source, torch.Generator().manual_seed(3)
    controls = rig.neutral_controls + 0.3 * torch.rand(len(meshes), len(rig.controls), generator=generator)
    change, rest = rig.coefficients(controls) - rig.neutral_coefficients(), rig.rest_vertices
    coordinates, distances, neutral = encoder.compare(rest, meshes, None, change)
    assert torch.equal(coordinates, encoder(rest, meshes))
    posed = rest.double() + (change.double() @ rig.basis.double().flatten(1)).unflatten(1, rest.shape)
    expected = frame_distances(meshes.double(), posed)
    from_rest = frame_distances(meshes.double(), rest[None].double())
    assert torch.equal(distances.vertex, expected.vertex) and torch.equal(distances.known, expected.known)
    for found, exact in (
        (distances.mean, expected.mean),
        (distances.worst, expected.worst),
        (distances.squares, expected.squares),
        (neutral.mean, from_rest.mean),
        (neutral.squares, from_rest.squares),
    ):
        torch.testing.assert_close(found.double(), exact, rtol=5e-5, atol=1e-5)
    unknown = meshes.clone()
    unknown[3, 100] = torch.nan
    _, found, _ = encoder.compare(rest, unknown, None, change)
    assert found.known.tolist() == [len(rest) - (mesh == 3) for mesh in range(len(meshes))]
