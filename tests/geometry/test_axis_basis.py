"""A basis of rows along one axis each: products axis by axis equal those of the whole basis."""

import torch

from riginv.geometry.axis_basis import MIN_NUMBERS, AxisBasisCache, axis_by_axis
from riginv.geometry.blendshapes import apply_deltas
from riginv.geometry.kernels.library import pure_torch
from riginv.rig.mesh_space import MeshSpace


def one_axis_each(rows: int, vertices: int) -> torch.Tensor:
    torch.manual_seed(0)
    basis = torch.zeros(rows, vertices, 3)
    for number in range(rows):
        basis[number, :, number * 2 % 3] = torch.randn(vertices)
    return basis


def test_products_and_displacements_equal_those_of_the_whole_basis():
    basis = one_axis_each(50, MIN_NUMBERS // 150 + 1)
    displacements, coefficients = torch.randn(4, *basis.shape[1:]), torch.randn(4, 50)
    found = AxisBasisCache().get(basis, coefficients)
    assert found is not None
    torch.testing.assert_close(
        found.products(displacements), displacements.flatten(1) @ basis.flatten(1).T, rtol=1e-5, atol=2e-3
    )
    expected = (coefficients @ basis.flatten(1)).unflatten(1, basis.shape[1:])
    torch.testing.assert_close(found.displacements(coefficients), expected, rtol=1e-5, atol=1e-5)


def test_other_bases_have_none():
    basis, cache = one_axis_each(50, MIN_NUMBERS // 150 + 1), AxisBasisCache()
    assert cache.get(basis, torch.zeros(1)) is cache.get(basis, torch.zeros(2)) is not None
    assert cache.get(basis, torch.zeros(1, dtype=torch.float64)) is None  # of another type
    assert cache.get(basis[:10], torch.zeros(1)) is None  # small
    several = basis.clone()
    several[7] = 1
    assert axis_by_axis(several) is None and cache.get(several, torch.zeros(1)) is None
    assert axis_by_axis(basis[:4]).tolist() == [0, 2, 1, 0]


def test_the_body_is_posed_and_encoded_as_by_its_whole_basis(body, body_in_space):
    space: MeshSpace = body_in_space.space
    controls = body.lower + torch.rand(3, len(body.controls)) * (body.upper - body.lower)
    vertices, change = body(controls), body.coefficients(controls) - body.neutral_coefficients()
    assert (vertices - apply_deltas(body.rest_vertices, body.basis, change)).abs().max() < 2e-3  # mm, of metres
    coordinates = space.encode(vertices)
    whole = (vertices - space.rest_vertices).flatten(1) @ space.directions.flatten(1).T
    assert (coordinates - whole).abs().max() < 1e-6 * whole.abs().max()
    assert (space.decode(coordinates) - vertices).abs().max() < 1e-2
    wanted = controls.requires_grad_()
    with pure_torch():
        gradient = torch.autograd.grad(body(wanted).sum(), wanted)[0]
    expected = torch.autograd.grad(apply_deltas(body.rest_vertices, body.basis, body.coefficients(wanted)).sum(), wanted)[0]
    torch.testing.assert_close(gradient, expected, rtol=1e-3, atol=1e-3 * float(expected.abs().max()))
