"""From meshes to controls: rigid motion, missing vertices, smoothness, flags."""

import pytest
import roma
import torch

from riginv.errors import InputError
from riginv.geometry.kinematics import apply_motion, remove_motion
from riginv.rig.batches import generator_at
from riginv.tracking.alternation import WindowInverter, interpolate_controls, interpolate_motion
from riginv.tracking.anchors import Anchors
from riginv.tracking.assembly import build_solver
from riginv.tracking.constraints import resolve_constraints
from riginv.tracking.estimators import SolverEstimator
from riginv.tracking.rigid import fit_rigid
from riginv.tracking.stability import has_root_controls, stability_weights
from tests.support.inverting import error_mm, inverted, options


def tumbled(meshes: torch.Tensor, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Meshes, turned at random by up to 90 degrees and moved by up to a metre each; and how."""
    generator, count = generator_at(seed, "tumble"), len(meshes)
    axes = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
    motion = torch.eye(4).repeat(count, 1, 1)
    motion[:, :3, :3] = roma.rotvec_to_rotmat(axes * torch.rand(count, 1, generator=generator) * torch.pi / 2)
    motion[:, :3, 3] = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1) * 1000
    return apply_motion(motion, meshes), motion


@pytest.fixture(scope="module")
def acted(face) -> torch.Tensor:
    """A stretch of a performance of the face, near its reach but not in it."""
    from riginv.clips.performance import simulated_performance

    return simulated_performance(face).vertices(300, 306)


def test_rigid_motion_is_found_whatever_a_third_of_the_vertices_does(rig):
    rest = rig.rest_vertices
    still = rest.expand(8, -1, -1).clone()
    still[:, ::3] += 20 * torch.randn(8, len(rest[::3]), 3, generator=generator_at(0, "noise"))
    target, motion = tumbled(still)
    found = fit_rigid(rest[None], target, torch.ones(len(rest)))
    assert (found - motion).abs().max() < 1e-3
    assert (remove_motion(found, apply_motion(found, still)) - still).abs().max() < 1e-2
    target[3, 5:] = torch.nan
    assert torch.isfinite(fit_rigid(rest[None], target, torch.ones(len(rest)))).all()


@pytest.fixture(scope="module")
def face_solver(face, face_in_space) -> SolverEstimator:
    settings = options(solver={"descent_steps": 0, "key_starts": 1, "steps": 15})
    return build_solver(settings, face_in_space, resolve_constraints(face, settings.controls), None, None, settings.method)


@torch.no_grad()
def test_a_moved_clip_gives_the_controls_of_the_unmoved_one(face, face_solver, acted):
    """Must reach: a difference of 0.05 mm at most, also from the clip that was solved without looking for motion."""
    anchors = Anchors(face, stability_weights(face))
    meshes, motion = tumbled(acted)
    kept, still, found = (
        WindowInverter(face, face_solver, looked_for, None, 12).invert(given)
        for looked_for, given in ((None, acted), (anchors, acted), (anchors, meshes))
    )
    errors = [float((face(one.controls) - acted).norm(dim=2).mean()) for one in (kept, still, found)]
    assert max(errors) - min(errors) < 0.05
    judged = [float((one.recovered - one.stabilised).norm(dim=2).mean()) for one in (still, found)]
    assert abs(judged[0] - judged[1]) < 0.01
    assert (apply_motion(found.motion, found.recovered) - meshes).norm(dim=2).mean() < errors[0] + 0.05
    assert (found.motion[:, :3, :3] - motion[:, :3, :3]).abs().max() < 0.01


@torch.no_grad()
def test_a_tenth_of_the_vertices_may_be_missing(face, face_solver, acted):
    """Must reach: the error on all vertices, also the missing ones, changes by 10 % at most."""
    holes = acted.clone()
    holes[torch.rand(holes.shape[:2], generator=generator_at(0, "holes")) < 0.1] = torch.nan
    inverter = WindowInverter(face, face_solver, None, None, 12)
    whole, found = (inverter.invert(given) for given in (acted, holes))
    errors = [float((face(one.controls) - acted).norm(dim=2).mean()) for one in (whole, found)]
    assert errors[1] < 1.1 * errors[0]


def test_missing_vertices_are_told_frame_by_frame(rig, meshes):
    holes = meshes.clone()
    holes[3, 10:20] = torch.nan
    found = inverted(rig, holes)
    assert [row for row, flags in enumerate(found.errors.flags) if "missing_vertices" in flags] == [3]
    assert error_mm(rig, found, meshes) < 0.05


def test_a_rig_with_a_root_keeps_its_motion(body_in_space, toy):
    assert has_root_controls(body_in_space) and not has_root_controls(toy)


def test_the_still_vertices_are_those_that_no_pose_moves(face):
    weights = stability_weights(face)
    skull, chin = face.rest_vertices[:, 1].argmax(), face.arkit_deltas()["jawOpen"].norm(dim=1).argmax()
    assert weights[skull] > 0.5 and weights[chin] < 0.05
    anchors = Anchors(face, weights)
    controls = torch.rand(3, len(face.controls), generator=generator_at(0, "poses")) * 0.2
    with torch.no_grad():
        assert (anchors.mesh(controls) - face(controls)[:, anchors.vertices]).abs().max() < 1e-3
    assert anchors.for_window(torch.zeros(2, len(weights), dtype=torch.bool)).stride == 1


def test_whole_frames_that_are_unknown_are_bridged(rig, meshes):
    gone = meshes.clone()
    gone[4:6] = torch.nan
    for method in ("levenberg_marquardt", "clip"):
        found = inverted(rig, gone, method=method)
        assert error_mm(rig, found, meshes) < 0.3
        assert found.errors.mean_mm[4:6].isnan().all() and found.errors.flags[4] == ["missing_vertices"]
    with pytest.raises(InputError, match="nothing to invert"):
        inverted(rig, torch.full_like(meshes, torch.nan))


def test_bridges_are_straight_and_turn_the_short_way():
    known = torch.tensor([False, True, False, False, True, False])
    values = torch.tensor([9.0, 0.0, 9.0, 9.0, 3.0, 9.0])[:, None]
    assert interpolate_controls(values, known, torch.arange(6)).flatten().tolist() == [0, 0, 1, 2, 3, 3]
    motion = torch.eye(4).repeat(6, 1, 1)
    motion[4, :3, :3] = roma.rotvec_to_rotmat(torch.tensor([0.0, 0.0, 0.9]))
    angles = roma.rotmat_to_rotvec(interpolate_motion(motion, known, torch.arange(6))[:, :3, :3])[:, 2]
    assert torch.allclose(angles, torch.tensor([0, 0, 0.3, 0.6, 0.9, 0.9]), atol=1e-5)


def test_excluded_frames_do_not_disturb_their_neighbours(rig, meshes):
    spoiled = meshes.clone()
    spoiled[6] += 30 * torch.randn(meshes[6].shape, generator=generator_at(0, "spoil"))
    found = inverted(rig, spoiled, frames={"exclude": [6]}, method="clip")
    assert error_mm(rig, found, meshes) < 0.2


def test_a_whole_clip_is_smoother_than_its_frames(rig, meshes):
    noisy = meshes + 0.5 * torch.randn(meshes.shape, generator=generator_at(0, "capture"))
    rough = [
        inverted(rig, noisy, method=method).controls.diff(n=2, dim=0).square().mean()
        for method in ("clip", "levenberg_marquardt")
    ]
    assert rough[0] < rough[1]


def test_frames_beyond_the_rig_are_flagged(rig, meshes):
    strange = meshes.clone()
    strange[7] += 6 * torch.randn(meshes[7].shape, generator=generator_at(0, "strange"))
    found = inverted(rig, strange)
    assert [row for row, flags in enumerate(found.errors.flags) if "outside_reach" in flags] == [7]
    assert int(found.errors.worst(1)[0]) == 7
