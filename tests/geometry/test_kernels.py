"""Compiled kernels against pure PyTorch in float64: values, gradients, gradients of gradients; and what stands in for them."""

import os
import subprocess
import sys

import pytest
import torch

from riginv.geometry.blendshapes import add_to_columns, combination_vjp, combination_weights, screen, screen_vjp
from riginv.geometry.curves import curves_and_derivatives, evaluate_curves, pack_curves
from riginv.geometry.distances import frame_distances
from riginv.geometry.kernels.build import LEVELS, CompilationError, compile_library, find_compiler
from riginv.geometry.kernels.library import kernels, kernels_for, pure_torch
from riginv.rig.interface import LinearRig
from riginv.runs.threads import Workers
from riginv.solvers.band import Band, second_difference_bands
from riginv.solvers.box_step import box_step, predicted_change
from riginv.tracking.rigid import fit_rigid, rigid_change
from tests.conftest import ROOT
from tests.geometry.test_curves import random_curves

needs_kernels = pytest.mark.skipif(kernels() is None, reason="there are no compiled kernels here: no C compiler")
MEMBERS = torch.tensor([[0, 1, -1, -1], [2, 5, 6, -1], [3, 4, 0, 1], [7, -1, -1, -1], [-1, -1, -1, -1], [2, 3, 4, 9]])
TRIPLES = torch.tensor([[0, 1, -1], [2, 5, 6], [7, -1, -1], [8, 9, 3]])


def both(function, *arguments):
    """What a function gives with kernels and without."""
    with pure_torch():
        pure = function(*arguments)
    return function(*arguments), pure


@needs_kernels
@pytest.mark.parametrize("count", [1, 31, 32, 100])
@pytest.mark.parametrize("longest_handle", [0.3, 2.0])
def test_curves_equal_those_of_pure_torch(count, longest_handle):
    table = pack_curves(random_curves(count, longest_handle))
    inputs = torch.rand(7, count, dtype=torch.float64) * 6 - 1
    inputs[0] = table[:, 0, 0]  # a curve's start has the derivative of its first segment
    for found, expected in zip(*both(curves_and_derivatives, table, inputs)):
        torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-11)


@needs_kernels
def test_curves_with_vertical_tangents_equal_those_of_pure_torch():
    table = pack_curves(random_curves(40, 0.0))
    values, pure = both(evaluate_curves, table, torch.rand(50, 40, dtype=torch.float64) * 5)
    torch.testing.assert_close(values, pure, rtol=0, atol=1e-7)


@needs_kernels
def test_nan_stays_nan_and_infinity_is_an_end():
    table = pack_curves(random_curves(3, 0.4))
    inputs = torch.tensor([[torch.nan, torch.inf, -torch.inf]], dtype=torch.float64)
    (values, derivatives), (pure, _) = both(curves_and_derivatives, table, inputs)
    assert values[0, 0].isnan() and derivatives[0, 1:].tolist() == [0, 0]
    torch.testing.assert_close(values[0, 1:], pure[0, 1:])


@needs_kernels
@pytest.mark.parametrize("members", [MEMBERS, TRIPLES], ids=["four slots", "three slots"])
@pytest.mark.parametrize(("combine", "vjp"), [(screen, screen_vjp), (combination_weights, combination_vjp)])
def test_products_equal_those_of_pure_torch(combine, vjp, members):
    factors = torch.rand(9, 10, dtype=torch.float64)
    factors[:, ::3] = 0  # a product of which one factor is 0 still has a gradient
    for found, expected in (
        both(combine, factors, members),
        both(vjp, factors, members, torch.randn(9, len(members), dtype=torch.float64)),
    ):
        torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-14)


@needs_kernels
@pytest.mark.parametrize("meshes", [6, 1], ids=["a source for each", "one source"])
def test_rigid_motion_equals_that_of_pure_torch(meshes):
    source = 60 * torch.randn(meshes, 300, 3, dtype=torch.float64)
    rotation = torch.linalg.qr(torch.randn(6, 3, 3, dtype=torch.float64))[0]
    target = source @ (rotation * rotation.det()[:, None, None]).mT + torch.tensor([0.0, 700.0, 50.0])
    target += torch.randn(6, 300, 3, dtype=torch.float64) * (torch.rand(6, 300, 1) < 0.3)  # what the skin does
    target[1, ::2], target[2, 2:] = torch.nan, torch.nan
    weights = torch.rand(300, dtype=torch.float64)
    found, pure = both(fit_rigid, source, target, weights)
    torch.testing.assert_close(found, pure, rtol=0, atol=1e-3)  # each frame ends on its own
    assert torch.equal(found[2], torch.eye(4).double())  # too few points
    start = found.clone()
    start[:, :3, 3] += 0.5
    for after, expected in zip(*both(fit_rigid, source, target, weights, start)):
        torch.testing.assert_close(after, expected, rtol=0, atol=1e-3)


@needs_kernels
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_change_by_a_motion_equals_that_of_pure_torch(dtype):
    before, after = torch.randn(2, 5, 4, 4, dtype=dtype)
    one, two = torch.randn(2, 5, 40, 3, dtype=dtype)
    found, pure = both(rigid_change, before, one, after, two)
    torch.testing.assert_close(found, pure, rtol=1e-5, atol=0)


@needs_kernels
def test_distances_equal_those_of_pure_torch():
    meshes, others = torch.randn(2, 5, 40, 3, dtype=torch.float64)
    meshes[1, 3, 2], meshes[2] = torch.nan, torch.nan
    for other, counted in ((others, None), (others[:1], torch.arange(40) % 3 > 0)):
        for found, pure in zip(*both(frame_distances, meshes, other, counted)):
            torch.testing.assert_close(found, pure, rtol=1e-12, atol=0)
    assert frame_distances(meshes, others).known.tolist() == [40, 39, 0, 40, 40]


@needs_kernels
def test_entries_are_added_to_columns_with_scales_and_without():
    entries, scales, columns = torch.randn(5, 12).double()[:, ::2], torch.rand(5, 6).double(), torch.tensor([0, 3, 3, 1, 0, 2])
    for scaled in (None, scales):
        found, pure = both(lambda given=scaled: add_to_columns(torch.ones(5, 4).double(), columns, entries, given))
        torch.testing.assert_close(found, pure, rtol=1e-12, atol=1e-14)


@needs_kernels
@pytest.mark.parametrize("order", ["gradcheck", "gradgradcheck"])
def test_gradients_equal_finite_differences(order):
    check = getattr(torch.autograd, order)
    factors = torch.rand(3, 10, dtype=torch.float64, requires_grad=True)
    assert check(lambda given: screen(given, TRIPLES), (factors,))
    assert check(lambda given: combination_weights(given, MEMBERS), (factors,))
    if order == "gradcheck":  # the second derivative of a curve has never been that of its solution
        table = pack_curves(random_curves(10, 0.4))
        inputs = torch.linspace(0.3, 1.5, 30, dtype=torch.float64).reshape(3, 10).requires_grad_()
        assert check(lambda given: evaluate_curves(table, given), (inputs,))


@needs_kernels
def test_the_face_equals_pure_torch_and_its_pull_equals_automatic_differentiation(face):
    controls = (face.lower + torch.rand(24, 137) * (face.upper - face.lower)).double()
    controls = torch.where(torch.rand(24, 137) < torch.linspace(0, 1, 24)[:, None], controls, face.neutral_controls.double())
    gradient = torch.randn(24, 628, dtype=torch.float64)
    found, vjp = face.coefficients_and_vjp(controls)
    by_kernel = vjp(gradient)
    with pure_torch():
        expected, by_autograd = LinearRig.coefficients_and_vjp(face, controls)
        _, in_torch = face.coefficients_and_vjp(controls)
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-12)
        for pulled in (by_kernel, vjp(gradient), in_torch(gradient)):
            torch.testing.assert_close(pulled, by_autograd(gradient), rtol=1e-10, atol=1e-10)
    torch.testing.assert_close(face.coefficients(controls), expected, rtol=0, atol=1e-12)


@needs_kernels
def test_a_row_does_not_depend_on_its_batch(face):
    controls = face.lower + torch.rand(9, 137) * (face.upper - face.lower)
    with torch.no_grad():
        assert torch.equal(face.coefficients(controls)[4:5], face.coefficients(controls[4:5]))


@needs_kernels
def test_what_kernels_cannot_compute_is_left_to_torch():
    values = torch.rand(2, 3)
    assert kernels_for(values, torch.tensor([0])) is not None
    for other in (values.half(), values.double(), values.to("meta"), torch.tensor([0], dtype=torch.int32)):
        assert kernels_for(values, other) is None
    with pure_torch():
        assert kernels_for(values) is None


@needs_kernels
@pytest.mark.parametrize("controls", [1, 7, 64, 137])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_steps_in_the_box_equal_those_of_pure_torch(controls, dtype):
    matrix = torch.randn(12, controls, 2 * controls, dtype=torch.float64)
    matrix = (matrix @ matrix.mT / controls).to(dtype)
    gradient, at = torch.randn(12, controls, dtype=dtype), torch.rand(12, controls, dtype=dtype).mul(1.4).sub(0.2).clamp(0, 1)
    diagonal = torch.rand(12, controls, dtype=dtype)
    tolerance = {"rtol": 1e-8, "atol": 1e-10} if dtype == torch.float64 else {"rtol": 1e-3, "atol": 2e-4}
    for matrices, added in ((matrix, diagonal), (matrix, None), (matrix[:1].expand(12, -1, -1), diagonal)):
        found, pure = both(box_step, matrices, gradient, at, added)
        torch.testing.assert_close(found, pure, **tolerance)
        assert ((at + found) >= -1e-6).all() and ((at + found) <= 1 + 1e-6).all()
    for value, pure in (both(predicted_change, matrix, gradient, found),):
        torch.testing.assert_close(value, pure, rtol=1e-4 if dtype == torch.float32 else 1e-12, atol=1e-4)


@needs_kernels
def test_a_matrix_that_is_not_positive_definite_is_tried_in_float64_and_then_left():
    nearly = torch.tensor([[1.0, 1.0], [1.0, 1.0 + 1e-9]], dtype=torch.float32)[None]
    other = -torch.eye(2)[None]
    gradient, at = torch.tensor([[-0.1, 0.1]]), torch.full((1, 2), 0.5)
    for matrix in (nearly, other):
        found, pure = both(box_step, matrix, gradient, at)
        assert torch.equal(found, pure) and (found == 0).all()
    close = torch.tensor([[1.0, 1.0 - 3e-8], [1.0 - 3e-8, 1.0]])[None]  # singular in float32's arithmetic, not in float64's
    found, pure = both(box_step, close + 6e-8 * torch.eye(2), gradient, at)
    torch.testing.assert_close(found, pure)


@needs_kernels
@pytest.mark.parametrize("frames", [1, 2, 3, 4, 5, 8, 9, 40])
@pytest.mark.parametrize("controls", [1, 5, 40])
def test_banded_systems_equal_those_of_pure_torch(frames, controls):
    blocks = torch.randn(frames, controls, controls, dtype=torch.float64)
    blocks = blocks @ blocks.mT
    main, near, far = (2 * band for band in second_difference_bands(frames, frames % 3))
    free = torch.rand(frames, controls) < 0.6
    free[1:2], free[2:3] = False, True  # a frame in which nothing is free, and one in which all is
    diagonal = torch.rand(frames, controls, dtype=torch.float64) + main[:, None] + 0.1
    band = Band(blocks, diagonal, near, far, torch.randn(frames, controls, dtype=torch.float64), free)
    found, pure = both(band.solve, lambda tasks: [task() for task in tasks])
    torch.testing.assert_close(found, pure, rtol=1e-9, atol=1e-9)
    assert (found[~free] == 0).all() and torch.equal(Band(*band).solve(Workers(2).run), found)
    indefinite = band._replace(blocks=blocks - 1000 * torch.eye(controls, dtype=torch.float64))
    assert (indefinite.solve(Workers(2).run) is None) == bool(free.any())


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("level", list(LEVELS))
def test_every_level_compiles(level, tmp_path):
    compile_library(tmp_path / "library", level)
    assert [path.name for path in tmp_path.iterdir()] == ["library"]


def test_without_a_compiler_torch_does_it_and_the_reason_is_known(tmp_path, monkeypatch):
    monkeypatch.setattr("riginv.geometry.kernels.build.find_compiler", lambda: None)
    with pytest.raises(CompilationError, match="no C compiler"):
        compile_library(tmp_path / "library", "plain")
    assert not list(tmp_path.iterdir())
    code = (
        "import torch; from riginv.geometry.kernels.library import kernels, why_not; from tests.support.toys import ToyRig; "
        "print(kernels(), why_not()); print(ToyRig()(torch.full((1, 7), 0.5)).shape)"
    )
    environment = {**os.environ, "PATH": "", "CC": "", "RIGINV_CACHE": str(tmp_path), "PYTHONPATH": str(ROOT)}
    for switch, says in (("0", "None RIGINV_KERNELS=0"), ("1", "no C compiler found")):
        done = subprocess.run(
            [sys.executable, "-c", code], env={**environment, "RIGINV_KERNELS": switch}, capture_output=True, text=True
        )
        installed = switch == "1" and "Kernels" in done.stdout  # in an installation they are there already
        assert (says in done.stdout or installed) and "torch.Size([1, 162, 3])" in done.stdout, done.stderr
