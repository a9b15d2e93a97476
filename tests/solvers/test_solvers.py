"""The solvers of riginv/solvers: their derivatives, their bounds, and what they do with what is degenerate."""

import pytest
import torch

from riginv.rig.batches import generator_at
from riginv.rig.interface import Control, LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.rig.random_controls import sparse_controls
from riginv.solvers.band import second_difference_bands, solve_band
from riginv.solvers.box_step import box_step
from riginv.solvers.clip import smoothed, solve_clip
from riginv.solvers.every_mesh import mean_distance_steps, solve_frames, solve_meshes
from riginv.solvers.levenberg_marquardt import levenberg_marquardt
from riginv.solvers.objective import Objective
from tests.support.toys import ToyRig

NO_PRIOR = 0.0


class Degenerate(ToyRig):
    """The toy with a control that does nothing and one that another repeats, so that its basis and its Jacobian lose rank."""

    def __init__(self) -> None:
        super().__init__()
        LinearRig.__init__(
            self,
            "degenerate",
            [*self.controls, Control("idle"), Control("again")],
            self.rest_vertices,
            self.faces,
            torch.cat([self.basis, self.basis[:1]]),
            [*self.coefficient_names, "copy"],
        )
        for name, value in ToyRig().named_buffers():
            if name in ("source", "curves", "drivers", "members"):
                self.register_buffer(name, value, persistent=False)

    def coefficients(self, controls):
        return torch.cat([super().coefficients(controls[:, :7]), controls[:, 8:]], dim=1)


def in_space(rig):
    return RigInMeshSpace(rig, MeshSpace.from_rig(rig))


def poses(rig, count, name="poses"):
    limits = rig.lower, rig.upper, rig.neutral_controls
    return sparse_controls(*limits, len(rig.controls), count, generator_at(0, name))


def inside(rig, count):
    """Poses away from limits and kinks, in float64, where differences taken to both sides are exact."""
    controls = poses(rig, count).double()
    middle = rig.lower + 0.37 * (rig.upper - rig.lower)
    return 0.6 * controls + 0.4 * middle


def mesh_error_mm(rig, found, expected):
    return (rig(found) - rig(expected)).norm(dim=2).mean(dim=1)


@pytest.mark.parametrize("name", ["face", "toy", "automatic face", "black box", "body"])
def test_jacobians_agree_with_finite_differences(name, face, toy, body):
    rig = {"toy": toy.source, "black box": toy.source, "body": body}.get(name, face)
    controls, step = inside(rig, 3), 1e-6
    answer = LinearRig.coefficient_jacobian if name == "automatic face" else type(rig).coefficient_jacobian
    if name == "black box":
        rig = ToyRig()
        rig.differentiable = False
    found, jacobian = answer(rig, controls)
    columns = [
        (rig.coefficients(controls + step * one) - rig.coefficients(controls - step * one)) / (2 * step)
        for one in torch.eye(controls.shape[1], dtype=torch.float64)
    ]
    expected = torch.stack(columns, dim=2)
    assert expected.abs().max() > 0.5
    tolerance = 2e-3 if name == "black box" else 1e-5 if name == "body" else 1e-7  # one-sided differences; millimetres
    torch.testing.assert_close(jacobian.dense(), expected, atol=tolerance, rtol=0)
    torch.testing.assert_close(found, rig.coefficients(controls))
    metric = torch.randn(found.shape[1], found.shape[1], generator=generator_at(0, "metric")).double()
    metric = metric @ metric.T
    gram = torch.einsum("bki,kl,blj->bij", jacobian.dense(), metric, jacobian.dense())
    torch.testing.assert_close(jacobian.gram(metric), gram, atol=1e-7, rtol=1e-10)
    pulled = torch.einsum("bk,bkj->bj", found, jacobian.dense())
    torch.testing.assert_close(jacobian.vjp(found), pulled, atol=1e-9, rtol=1e-10)


def test_the_gradient_is_that_of_the_cost(face_in_space):
    objective = Objective(face_in_space, prior=1e-5, sparsity=1e-4, dtype=torch.float64)
    units = objective.units(inside(face_in_space.source, 2))
    target = face_in_space(inside(face_in_space.source, 5)[3:].float()).double()
    given = torch.eye(len(objective.span), dtype=torch.float64) * 1e-6
    near = objective.linearise(units, target)
    numeric = [(objective.cost(units + one, target) - objective.cost(units - one, target)) / 2e-6 for one in given]
    numeric = torch.stack(numeric, dim=1)
    torch.testing.assert_close(near.gradient, numeric, atol=1e-4 * float(numeric.abs().max()), rtol=1e-4)
    torch.testing.assert_close(objective.gradient(units, target), near.gradient)
    torch.testing.assert_close(objective.cost(units, target), near.cost)


def test_a_pose_of_the_rig_is_recovered_from_a_start_near_it(face_in_space):
    rig, objective = face_in_space.source, Objective(face_in_space, NO_PRIOR)
    controls = poses(rig, 6)
    near = objective.units(controls) + 0.01 * torch.randn(controls.shape, generator=generator_at(0, "near"))
    found = levenberg_marquardt(objective, face_in_space(controls), near, 80, 1e-9)
    assert mesh_error_mm(rig, objective.to_controls(found.units), controls).max() < 1e-3


def test_bounds_hold_exactly_even_where_the_mesh_lies_beyond_them(face_in_space):
    rig, objective = face_in_space.source, Objective(face_in_space)
    weights = 3 * torch.randn(8, len(face_in_space.linear_map), generator=generator_at(0, "beyond"))
    found = objective.to_controls(solve_meshes(objective, weights @ face_in_space.linear_map, 1, 15).units)
    assert (found >= rig.lower).all() and (found <= rig.upper).all()
    assert ((found == rig.lower) | (found == rig.upper)).any()


def test_the_step_in_a_box_is_the_best_one():
    generator = generator_at(0, "box")
    root = torch.randn(20, 3, 5, generator=generator, dtype=torch.float64)
    matrix = root.transpose(1, 2) @ root + torch.eye(5)
    gradient = torch.randn(20, 5, generator=generator, dtype=torch.float64)
    at = torch.rand(20, 5, generator=generator, dtype=torch.float64)
    slow = torch.zeros_like(at)
    for _ in range(5000):  # projected gradient, slow and sure
        slow = (at + slow - 0.05 * (gradient + (matrix @ slow[..., None])[..., 0])).clamp(0, 1) - at

    def model(step):
        return (gradient * step).sum(dim=1) + 0.5 * (step * (matrix @ step[..., None])[..., 0]).sum(dim=1)

    found = box_step(matrix, gradient, at)
    assert ((at + found) >= 0).all() and ((at + found) <= 1).all()
    assert (model(found) <= 0.7 * model(slow)).all()  # nearly: a pinned control is not let go within one step
    assert (model(found) <= model(slow) + 1e-6).float().mean() > 0.6


def test_a_rank_deficient_rig_and_an_idle_control(face):
    rig = Degenerate()
    space = in_space(rig)
    assert space.space.size < len(rig.basis)
    objective, controls = Objective(space), poses(rig, 20)
    found = solve_meshes(objective, space(controls), 3)
    assert mesh_error_mm(rig, objective.to_controls(found.units), controls).median() < 5e-2
    assert torch.isfinite(found.units).all()
    torch.testing.assert_close(found.units[:, 7], torch.zeros(20), atol=1e-3, rtol=0)  # the prior keeps it at neutral


def test_a_frame_of_nans_is_reported_and_its_neighbours_are_untouched(toy):
    objective, coordinates = Objective(toy), toy(poses(toy.source, 12))
    broken = coordinates.clone()
    broken[5], broken[7, 0] = torch.nan, torch.inf
    whole, found = solve_meshes(objective, coordinates), solve_meshes(objective, broken)
    assert found.skipped.nonzero()[:, 0].tolist() == [5, 7]
    torch.testing.assert_close(found.units[found.skipped], objective.neutral.expand(2, -1))
    torch.testing.assert_close(found.units[~found.skipped], whole.units[~found.skipped], atol=1e-4, rtol=0)
    assert found.cost[~found.skipped].isfinite().all() and found.cost[found.skipped].isnan().all()
    frames = solve_frames(objective, broken)
    assert frames.skipped.nonzero()[:, 0].tolist() == [5, 7]
    assert torch.isfinite(frames.units).all()
    clip = solve_clip(objective, broken, smoothed(frames, 1.0), 1e-3)
    assert torch.isfinite(clip).all()


@pytest.mark.parametrize("count", [0, 1, 2, 3, 9])
def test_clips_of_any_length(toy, count):
    objective, coordinates = Objective(toy), toy(poses(toy.source, 9))[:count]
    frames = solve_frames(objective, coordinates)
    assert frames.units.shape == (count, 7)
    clip = solve_clip(objective, coordinates, smoothed(frames, 2.0), 1e-4)
    assert clip.shape == (count, 7) and torch.isfinite(clip).all()


def moving(toy, frames):
    """A clip of the toy whose controls rise and fall smoothly, and its noisy mesh coordinates."""
    time = torch.linspace(0, 6, frames)[:, None]
    shift = torch.arange(7) * 0.8
    controls = (0.5 + 0.5 * torch.sin(time + shift)).float()
    coordinates = toy(controls)
    return controls, coordinates + 0.3 * torch.randn(coordinates.shape, generator=generator_at(0, "clip"))


def test_windows_equal_one_solve(toy):
    objective = Objective(toy)
    controls, coordinates = moving(toy, 150)
    start = objective.units(controls)
    whole = solve_clip(objective, coordinates, start, 0.1, 20, window=1000, tolerance=0)
    # Where a shape is screened flat, its control hardly matters: two per cent of the way there is nothing in the mesh.
    windows = solve_clip(objective, coordinates, start, 0.1, 20, window=40, lookahead=40, tolerance=0)
    moved = (whole - start).abs().max()
    assert moved > 0.02
    torch.testing.assert_close(windows, whole, atol=float(moved) * 0.02, rtol=0)


def test_a_clip_becomes_smooth_at_little_cost(toy):
    objective = Objective(toy)
    _, coordinates = moving(toy, 80)
    frames = solve_frames(objective, coordinates)
    found = solve_clip(objective, coordinates, smoothed(frames, 2.0), 1e-1)

    def roughness(units):
        return (units[2:] - 2 * units[1:-1] + units[:-2]).square().mean()

    assert roughness(found) < 0.05 * roughness(frames.units)
    assert objective.cost(found, coordinates).mean() < 1.3 * frames.cost.mean()


@pytest.mark.parametrize("window", [1000, 50])
def test_fast_motion_that_the_rig_makes_is_kept_and_noise_is_smoothed(toy, window):
    objective, exact = Objective(toy), slice(0, 50)  # the frames next to noisy ones are smoothed like them
    controls, noisy = moving(toy, 120)
    controls[30] = controls[30].roll(1)  # a jump for one frame
    coordinates, own = torch.cat([toy(controls[:60]), noisy[60:]]), objective.units(controls)
    start = own.unfold(0, 5, 1).mean(dim=2)[torch.arange(120).clamp(2, 117) - 2]

    def solve(full_smoothness_mm):
        return solve_clip(objective, coordinates, start, 0.1, window=window, full_smoothness_mm=full_smoothness_mm, own=own)

    plain, adapted = solve(0.0), solve(0.02)
    cost = [float(objective.cost(found[exact], coordinates[exact]).max()) for found in (plain, adapted)]
    assert cost[1] < 1e-3 * cost[0]
    away = [float((toy(objective.to_controls(found)) - toy(controls)).norm(dim=1)[30]) for found in (plain, adapted)]
    assert away[1] < 0.01 * away[0]
    torch.testing.assert_close(adapted[80:], plain[80:], atol=2e-3, rtol=0)  # what is noise is smoothed as before


def test_broken_frames_are_interpolated_between_exact_ones(toy):
    objective = Objective(toy)
    controls, _ = moving(toy, 40)
    coordinates = toy(controls)
    coordinates[20] = torch.nan
    found = solve_clip(objective, coordinates, objective.units(controls), 0.1, full_smoothness_mm=0.02)
    torch.testing.assert_close(toy(objective.to_controls(found)), toy(controls), atol=0.05, rtol=0)


@pytest.mark.parametrize(("frames", "before"), [(1, 0), (2, 0), (3, 0), (7, 0), (1, 2), (2, 2), (7, 1), (7, 2)])
def test_a_banded_system_is_solved(frames, before):
    generator, controls = generator_at(0, "band"), 4
    root = torch.randn(frames, controls, controls, generator=generator, dtype=torch.float64)
    blocks = root @ root.transpose(1, 2) + torch.eye(controls)
    right = torch.randn(frames, controls, generator=generator, dtype=torch.float64)
    main, near, far = second_difference_bands(frames, before)
    total = before + frames
    difference = torch.zeros(max(total - 2, 0), total, dtype=torch.float64)
    for row in range(total - 2):
        difference[row, row : row + 3] = torch.tensor([1.0, -2.0, 1.0], dtype=torch.float64)
    square = (difference.T @ difference)[before:, before:]
    full = torch.block_diag(*blocks) + torch.kron(square, torch.eye(controls, dtype=torch.float64))
    expected = torch.linalg.solve(full, right.flatten()).view(frames, controls)
    wide = blocks + torch.diag_embed(main[:, None].expand(-1, controls))
    found = solve_band(wide, near[:, None].expand(-1, controls), far[:, None].expand(-1, controls), right)
    torch.testing.assert_close(found, expected)
    assert solve_band(-wide, near[:, None].expand(-1, controls), far[:, None].expand(-1, controls), right) is None


def test_steps_on_the_mean_distance_lower_it_and_keep_fixed_controls(face_in_space):
    objective, rig = Objective(face_in_space, prior=NO_PRIOR), face_in_space.source
    target = poses(rig, 24)
    start = (target + 0.05 * torch.randn(target.shape, generator=generator_at(0, "start"))).clamp(rig.lower, rig.upper)
    fixed = torch.arange(len(rig.controls)) == 3
    coordinates, units = face_in_space(target), objective.units(start)
    before = mesh_error_mm(rig, start, target).mean()
    one, three = (objective.to_controls(mean_distance_steps(objective, coordinates, units, steps)) for steps in (1, 3))
    assert mesh_error_mm(rig, one, target).mean() < 0.8 * before
    assert mesh_error_mm(rig, three, target).mean() < mesh_error_mm(rig, one, target).mean()
    held = mean_distance_steps(objective, coordinates, units, 3, fixed)
    assert (held[:, 3] - units[:, 3]).abs().max() < 1e-4
    assert held.min() >= 0 and held.max() <= 1
