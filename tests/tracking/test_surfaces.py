"""Closest points, and fits of small rigs to scans of their own surface."""

import numpy as np
import pytest
import torch
import trimesh

from riginv.solvers.band import second_difference_bands, second_differences
from riginv.solvers.objective import GaussianPrior
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.priors.prior import ControlPrior, independent_measurements
from riginv.tracking.stability import stability_weights
from riginv.tracking.surfaces.alignment import Aligner
from riginv.tracking.surfaces.clip import ScanSmoothness, cached_scans, eliminate_motion, smooth_scans
from riginv.tracking.surfaces.fitting import ROTATION, Linearised, State, SurfaceFit
from riginv.tracking.surfaces.limited_cache import LimitedCache
from riginv.tracking.surfaces.matching import Target, match
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.rig_surface import RigSurface, farthest_points
from riginv.tracking.surfaces.solving import ScanSettings, ScanSolver
from riginv.tracking.surfaces.triangles import PointCloud, TriangleMesh
from tests.support.scans import posed_mesh, resampled
from tests.support.toys import ToyRig

CONTROLS = torch.tensor([0.3, 0.6, 0.2, 0.5, 0.4, -0.5, 0.3])


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig(detail=3)


@pytest.fixture(scope="module")
def fit(rig) -> SurfaceFit:
    prior = default_prior(rig)
    return SurfaceFit(RigSurface(rig, 400), GaussianPrior(prior.mean, 1e-5 * prior.precision))


def near(fit: SurfaceFit, seed: int = 0) -> Linearised:
    target = Target.of(resampled(fit.surface.rig, CONTROLS), 400)
    state = State(
        torch.full((7,), 0.45, dtype=torch.float64), Motion.identity().after(np.full(3, 0.01), np.ones(3), np.zeros(3))
    )
    posed = fit.posed(state)
    return Linearised(fit, state, match(fit.surface, posed, target, state.motion, 10.0, 60.0))


def test_the_closest_point_is_the_closest(rig):
    mesh = resampled(rig, CONTROLS)
    rng = np.random.default_rng(0)
    queries = mesh.points[:20] + rng.normal(0, 4, (20, 3))
    weights = rng.dirichlet(np.ones(3), (3000, len(mesh.faces[:1])))[:, 0]
    hits = mesh.closest(queries)
    for query, distance in zip(queries, hits.distance):
        spread = np.einsum("sc,fcd->sfd", weights[:200], mesh.points[mesh.faces]).reshape(-1, 3)
        assert distance <= np.linalg.norm(spread - query, axis=1).min() + 1e-9
    found = (hits.barycentric[..., None] * mesh.points[hits.corners]).sum(axis=1)
    np.testing.assert_allclose(found, hits.points, atol=1e-6)


def test_a_mesh_near_another_shares_its_tree_and_finds_the_same(rig):
    first, moved = resampled(rig, CONTROLS), resampled(rig, CONTROLS + 0.005)
    queries = moved.points[::3] + 0.4 * moved.normals[::3]
    exact = moved.closest(queries)
    near = TriangleMesh(moved.points, moved.faces, near=first)
    shared = near.closest(queries)
    assert "_tree" not in vars(near)
    np.testing.assert_allclose(shared.distance, exact.distance, atol=0.01)
    np.testing.assert_allclose(shared.points, exact.points, atol=0.05)
    far = TriangleMesh(moved.points + 1.5, moved.faces, near=near)
    np.testing.assert_allclose(far.closest(queries + 1.5).distance, exact.distance, atol=1e-9)
    assert "_tree" in vars(far)


def test_hits_at_the_edge_of_an_open_surface_are_on_its_border():
    square = TriangleMesh(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    hits = square.closest(np.array([[0.5, 0.4, 1], [2, 0.5, 0], [-1, -1, 0], [0.5, 0.5, 1]]))
    assert hits.on_border.tolist() == [False, True, True, False]  # the last lies on the inner edge


def test_a_cloud_gets_normals_that_point_outwards(rig):
    mesh = resampled(rig, CONTROLS)
    cloud = PointCloud(mesh.points)
    assert ((cloud.normals * mesh.normals).sum(axis=1) > 0.8).mean() > 0.98


def test_gradients_are_those_of_finite_differences(fit):
    linear = near(fit)
    gradient = linear.normal.gradient.clone()
    gradient[:7] += fit.prior.gradient(linear.state.units[None])[0]
    for number in range(len(gradient)):
        change, step = torch.zeros(len(gradient), dtype=torch.float64), 1e-3 if number < 7 else 1e-4
        change[number] = step
        derivative = (linear.cost(change) - linear.cost(-change)) / (2 * step)
        assert derivative == pytest.approx(float(gradient[number]), rel=2e-2, abs=2e-3 * float(gradient.abs().max()))


def test_rigid_motion_moves_pairs_as_their_rows_say(fit):
    linear = near(fit)
    turn = torch.zeros(len(linear.normal.gradient), dtype=torch.float64)
    turn[7] = 1e-3 / ROTATION
    moved = linear.after(turn)
    centre = fit.surface.centre
    point = centre + np.array([0.0, 10.0, 0.0])
    at = linear.state.motion.undo(moved.motion.apply(point[None]))[0]
    np.testing.assert_allclose(at - point, np.cross([1e-3, 0, 0], point - centre), atol=1e-5)


def test_eliminating_motion_gives_the_step_of_the_dense_system(fit):
    linear = near(fit)
    count, (_, gradient, hessian) = 7, linear.normal
    hessian, gradient = hessian.clone(), gradient.clone()
    hessian[:count, :count] += fit.prior.precision
    gradient[:count] += fit.prior.gradient(linear.state.units[None])[0]
    dense = torch.linalg.solve(hessian, -gradient)
    reduced = eliminate_motion(fit, linear)
    step = torch.linalg.solve(reduced.hessian, -reduced.gradient)
    follow = reduced.follow[:, 0] + reduced.follow[:, 1:] @ step
    torch.testing.assert_close(torch.cat([step, follow]), dense, rtol=1e-3, atol=1e-6)


def test_a_scan_of_the_rigs_own_surface_is_recovered(rig):
    solver = ScanSolver(rig, default_prior(rig), ScanSettings(samples=600, noise_mm=0.01), moves=False)
    found = solver.solve(solver.target(resampled(rig, CONTROLS)))
    mesh = solver.surface.vertices(solver.fit_of(1.0).coefficients(found.state.units))
    assert np.linalg.norm(mesh - posed_mesh(rig, CONTROLS)[0], axis=1).mean() < 0.02
    assert solver.flags(found) == [] and found.quality.explained > 0.99


def test_a_prior_means_the_same_however_densely_a_scan_is_sampled(rig):
    mesh = resampled(rig, CONTROLS)
    sparse, dense = (torch.from_numpy(mesh.samples(count, 0)[0]) for count in (4_000, 40_000))
    assert independent_measurements(dense) == pytest.approx(independent_measurements(sparse), rel=0.05)
    few = sparse[farthest_points(sparse.numpy(), 50)]
    assert independent_measurements(few) == 50  # 50 markers count as 50


def test_other_vertices_of_the_same_surface_give_the_same_answer(rig):
    solver = ScanSolver(rig, default_prior(rig), ScanSettings(samples=600), moves=False)
    one, other = (solver.solve(solver.target(resampled(rig, CONTROLS, seed))).state.units for seed in (0, 1))
    assert float((one - other).abs().max()) < 0.05


def test_a_scan_that_was_turned_and_moved_is_found(face):
    surface = RigSurface(face, 800)
    mesh = surface.pose(face.neutral_controls).mesh
    aligner = Aligner(mesh, np.flatnonzero(surface.outer), surface.sampled, surface.stability)
    motion = Motion.identity().after(np.radians([12.0, -12, 10]), np.array([30.0, -30, 26]), surface.centre)
    scan = TriangleMesh(motion.apply(mesh.points), mesh.faces)
    found = aligner.align(Target.of(scan, 800)).motion
    away = np.linalg.norm(found.apply(mesh.points) - scan.points, axis=1)
    assert away.max() < 1.0


def test_smoothing_follows_the_frames_and_fills_a_gap(rig):
    amounts = torch.linspace(0, 1, 7)
    controls = [torch.tensor([0.3, 0.2, 0.2 + 0.4 * float(a), 0.5, 0.1, 0.3, 0.2]) for a in amounts]
    solver = ScanSolver(rig, default_prior(rig), ScanSettings(samples=400, noise_mm=0.01), moves=False)
    targets = [solver.target(resampled(rig, row, seed)) for seed, row in enumerate(controls)]
    targets[3] = None
    found = [None if target is None else solver.solve(target) for target in targets]
    smooth = smooth_scans(solver, cached_scans(lambda row: targets[row]), found, ScanSmoothness(smoothness=1.0))
    for each, row in zip(smooth, controls):
        mesh = solver.surface.vertices(solver.fit_of(1.0).coefficients(each.state.units))
        assert np.linalg.norm(mesh - posed_mesh(rig, row)[0], axis=1).mean() < 0.1


def test_weighted_second_differences_leave_out_what_counts_nothing():
    main, near_by, far = second_difference_bands(6, 0, torch.tensor([[1.0], [0], [0], [1]]) * second_differences(torch.ones(5)))
    assert (
        main.tolist() == [1, 4, 1, 1, 4, 1]
        and near_by.tolist() == [-2, -2, 0, -2, -2, 0]
        and far.tolist() == [1, 0, 0, 1, 0, 0]
    )


def test_single_poses_are_not_smoothed(rig):
    poses = [0.1, 0.9, 0.12, 0.85, 0.9, 0.91]  # the last three alone would be neighbours in time
    controls = [torch.tensor([0.3, amount, amount, 0.5, 0.1, 0.3, 0.2]) for amount in poses]
    solver = ScanSolver(rig, default_prior(rig), ScanSettings(samples=400, noise_mm=0.01), moves=False)
    targets = [solver.target(resampled(rig, row, seed)) for seed, row in enumerate(controls)]
    found = [solver.solve(target) for target in targets]
    none, much = (
        smooth_scans(solver, cached_scans(targets.__getitem__), found, ScanSmoothness(smoothness))
        for smoothness in (0.0, 100.0)
    )
    for one, other in zip(none, much):
        torch.testing.assert_close(one.state.units, other.state.units)


@pytest.mark.slow
def test_an_open_mouth_with_the_tongue_out_is_found(face):
    weights = {"jawOpen": 0.7, "tongueOut": 1.0, "mouthFunnel": 0.2, "mouthShrugUpper": 0.4}
    weights |= {f"{name}{side}": 0.5 for name in ("mouthLowerDown", "mouthStretch") for side in ("Left", "Right")}
    deltas = face.arkit_deltas()
    truth = (face.rest_vertices + sum(weight * deltas[name] for name, weight in weights.items())).numpy()
    points, faces = trimesh.remesh.subdivide(truth, face.faces.numpy())
    scan = points + np.random.default_rng(0).normal(0, 0.3, points.shape)
    solver = ScanSolver(face, default_prior(face), stability=stability_weights(face).numpy())
    found = solver.solve(solver.target(TriangleMesh(scan, faces)))
    mesh = solver.surface.vertices(solver.fit_of(1.0).coefficients(found.state.units))
    assert np.linalg.norm(mesh - truth, axis=1).mean() < 1.0


def test_values_are_computed_once_while_there_is_room():
    asked = []
    kept = LimitedCache(lambda row: asked.append(row) or [row] * 10, len, limit=25)
    assert [kept(row)[0] for row in (0, 1, 2, 0, 1, 2)] == [0, 1, 2, 0, 1, 2] and asked == [0, 1, 2, 2]
    kept.drop_before(1)
    assert [kept(row)[0] for row in (2, 2, 0)] == [2, 2, 0] and asked == [0, 1, 2, 2, 2, 0]


def test_more_points_of_a_noisy_scan_lower_the_error(rig):
    prior = ControlPrior(rig.control_names, torch.full((7,), 0.5).double(), 10 * torch.eye(7).double())
    solver = ScanSolver(rig, prior, ScanSettings(samples=150, fine_samples=2000), moves=False)
    errors = []
    for seed in range(4):
        controls = torch.tensor([0.3, 0.6, 0.2, 0.5, 0.4, -0.5, 0.3])
        scan, rng = resampled(rig, controls, seed), np.random.default_rng(seed)
        noisy = TriangleMesh(scan.points + rng.normal(0, 0.5, scan.points.shape), scan.faces)
        found = solver.solve(solver.target(noisy))
        both = (found, solver.finished(solver.target(noisy), found))
        poses = [rig(solver.fit_of(1.0).controls(each.state.units)[None]) for each in both]
        errors.append([float((pose - rig(controls[None])).norm(dim=2).mean()) for pose in poses])
    coarse, fine = np.mean(errors, axis=0)
    assert fine < 0.9 * coarse, errors
