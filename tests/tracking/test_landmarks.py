"""Landmarks of scans: the term and its derivatives, alignment, and what their noise costs."""

import numpy as np
import pytest
import torch

from riginv.solvers.objective import GaussianPrior
from riginv.tracking.markers.placement import Placement, at_vertices
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.stability import stability_weights
from riginv.tracking.surfaces.fitting import Linearised, State, SurfaceFit
from riginv.tracking.surfaces.landmarks import WIDE_MM, Landmarks
from riginv.tracking.surfaces.matching import Target, match
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.rig_surface import RigSurface
from riginv.tracking.surfaces.solving import ScanSolver
from riginv.tracking.surfaces.triangles import TriangleMesh
from tests.support.markers import placed
from tests.support.scans import posed_mesh, resampled
from tests.support.toys import ToyRig

CONTROLS = torch.tensor([0.3, 0.6, 0.2, 0.5, 0.4, -0.5, 0.3])


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig(detail=3)


def observed(rig, placement: Placement, motion: Motion, noise_mm: float = 0.0, seed: int = 0) -> Landmarks:
    """The landmarks of the pose `CONTROLS`, moved."""
    with torch.no_grad():
        points = motion.apply(placement.points(rig(CONTROLS[None])[0]).double().numpy())
    return Landmarks(placement, points + np.random.default_rng(seed).normal(0, noise_mm, points.shape))


@pytest.mark.parametrize("offset_mm", [0.0, 6.0])
def test_derivatives_of_the_term_are_those_of_finite_differences(rig, offset_mm):
    prior, placement = default_prior(rig), placed(rig, 5, offset_mm)
    fit = SurfaceFit(RigSurface(rig, 300), GaussianPrior(prior.mean, 1e-5 * prior.precision))
    motion = Motion.identity().after(np.full(3, 0.01), np.ones(3), np.zeros(3))
    landmarks = observed(rig, placement, Motion.identity())
    units = torch.full((7,), 0.45, dtype=torch.float64)

    def cost(at: State) -> float:
        away = at.motion.apply(landmarks.on(fit.surface.vertices(fit.coefficients(at.units)))) - landmarks.points
        return 0.5 * (away**2).sum(axis=1).mean()

    target = Target.of(resampled(rig, CONTROLS), 300, landmarks=landmarks)
    state = State(units, motion)
    posed = fit.surface.posed(fit.coefficients(units))
    pairs = match(fit.surface, posed, target, motion, WIDE_MM, 60.0)
    both = Linearised(fit, state, pairs, target.landmark_term(fit.surface, posed, motion, WIDE_MM))
    alone = Linearised(fit, state, pairs)
    assert both.normal.cost - alone.normal.cost == pytest.approx(cost(state), rel=1e-4)
    gradient = both.normal.gradient - alone.normal.gradient
    for number in range(len(gradient)):
        change, step = torch.zeros(len(gradient), dtype=torch.float64), 1e-2 if number < 7 else 1e-4
        change[number] = step
        derivative = (cost(both.after(change)) - cost(both.after(-change))) / (2 * step)
        assert derivative == pytest.approx(float(gradient[number]), rel=1e-2, abs=2e-3 * float(gradient.abs().max()))


def error_mm(solver: ScanSolver, units: torch.Tensor, truth: np.ndarray) -> float:
    mesh = solver.surface.vertices(solver.fit_of(1.0).coefficients(units))
    return float(np.linalg.norm(mesh - truth, axis=1).mean())


def test_half_a_face_on_its_side_is_found_by_four_landmarks(face):
    """Turned by 120 degrees about the axis that it looks along, it is lost without them; 2 mm of noise cost next to nothing."""
    solver = ScanSolver(face, default_prior(face), stability=stability_weights(face).numpy())
    controls = face.neutral_controls.clone()
    for name, value in {"jawOpen": 0.5, "mouthSmileLeft": 0.7, "browInnerUp": 0.6}.items():
        controls[face.control_names.index(name)] = value
    mesh, faces = posed_mesh(face, controls)
    motion = Motion(np.array([[-0.5, -(0.75**0.5), 0], [0.75**0.5, -0.5, 0], [0, 0, 1]]), np.array([100.0, 50, -30]))
    front = mesh[:, 2] > np.median(mesh[:, 2])
    kept = faces[front[faces].all(axis=1)]
    scan = TriangleMesh(motion.apply(mesh[front]), (np.cumsum(front) - 1)[kept])
    lost = solver.aligner.align(solver.target(scan)).motion
    assert np.linalg.norm(lost.apply(mesh) - motion.apply(mesh), axis=1).mean() > 20
    skin = solver.surface.sampled[front[solver.surface.sampled]]
    placement = at_vertices(face, list("abcd"), skin[np.linspace(0, len(skin) - 1, 4).astype(int)].tolist(), 0.0)
    errors = []
    for noise_mm in (0.0, 2.0):
        points = motion.apply(placement.points(torch.from_numpy(mesh)).numpy())
        points += np.random.default_rng(0).normal(0, noise_mm, points.shape)
        found = solver.solve(solver.target(scan, Landmarks(placement, points)))
        errors.append(error_mm(solver, found.state.units, mesh))
    exact, noisy = errors
    assert exact < 0.3 and noisy < exact + 0.05
