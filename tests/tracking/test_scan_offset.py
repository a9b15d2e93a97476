"""The offset of an actor from the rig, found with the controls of scans."""

import numpy as np
import pytest
import torch

from riginv.tracking.actors.scan_offset import ScanOffset, ScanOffsetSettings
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.surfaces.fitting import State
from riginv.tracking.surfaces.matching import match
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.solving import ScanSettings, ScanSolver
from riginv.tracking.surfaces.triangles import TriangleMesh
from tests.support.scans import resampled
from tests.support.toys import ToyRig


@pytest.fixture(scope="module")
def solver() -> ScanSolver:
    rig = ToyRig()
    return ScanSolver(rig, default_prior(rig), ScanSettings(samples=500))


def bump(rest: np.ndarray) -> np.ndarray:
    """A smooth outward displacement of up to 5 mm on one side of a sphere."""
    outward = rest / np.linalg.norm(rest, axis=1, keepdims=True)
    return 5 * np.exp(-0.5 * ((rest - [30, 30, 26]) ** 2).sum(axis=1, keepdims=True) / 20**2) * outward


def test_the_field_moves_points_as_its_columns_say(solver):
    search = ScanOffset(solver, ScanOffsetSettings(modes=20))
    target = solver.target(resampled(solver.rig, solver.rig.neutral_controls))
    state, field = State(solver.start, Motion.identity()), torch.linspace(-3, 3, 60, dtype=torch.float64)
    fit = solver.fit(target)
    posed = fit.posed(state)
    pairs = match(fit.surface, posed, target, state.motion, 5.0, 60.0)
    moved = search.neutral(field) - search.neutral(torch.zeros(60, dtype=torch.float64))
    at_points = (pairs.barycentric[..., None] * moved[pairs.corners]).sum(axis=1)
    expected = (at_points * pairs.normals).sum(axis=1)
    found = search._columns(pairs).double() @ field
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert np.abs(expected).max() > 0.5


def test_a_bump_is_found_under_expressions(solver):
    rig = solver.rig
    still, rest = ScanSolver(rig, solver.prior, solver.settings, moves=False), rig.rest_vertices.double().numpy()
    targets = []
    for number in range(7):
        controls = rig.neutral_controls.clone()
        controls[number] = 0.5
        scan = resampled(rig, controls, number)
        targets.append(still.target(TriangleMesh(scan.points + bump(scan.points), scan.faces)))
    found = ScanOffset(still, ScanOffsetSettings()).solve(targets)
    truth = TriangleMesh(rest + bump(rest), rig.faces.numpy())
    before, after = (truth.closest(mesh).distance for mesh in (rest, found))
    assert after.mean() < 0.4 * before.mean() and after.max() < 0.5 * before.max(), (after.mean(), before.mean())
