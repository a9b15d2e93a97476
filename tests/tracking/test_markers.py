"""Inversion of markers: the objective, labels, offsets, the map, and the command."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from riginv.clips.markers import MarkerClip
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import SourceFacts
from riginv.errors import InputError
from riginv.tracking.constraints import resolve_constraints
from riginv.tracking.markers.assembly import build_objective
from riginv.tracking.markers.map_file import matched, read_map, write_map
from riginv.tracking.markers.objective import MarkerObjective, pack
from riginv.tracking.markers.placement import Placement, point_derivatives, points_on
from riginv.tracking.markers.tracking import MarkerTrack, track_markers
from riginv.tracking.options import ControlOptions, SolverOptions, TrackingOptions
from riginv.tracking.priors.prior import learn_prior
from riginv.tracking.priors.takes import Take, with_changes
from tests.conftest import ROOT
from tests.support.markers import placed, played, write_c3d
from tests.support.toys import ToyRig

CONF = f"{ROOT}/tests/conf"
FRAMES, MARKERS = 40, 40


@pytest.fixture(scope="module")
def toy_rig() -> ToyRig:
    return ToyRig()


def objective_of(rig, placement: Placement, moves: bool = False, noise_mm: float = 0.1) -> MarkerObjective:
    prior = learn_prior(rig, played(rig, 60), "itself")
    options = TrackingOptions(correspondence="markers", markers="-", noise_mm=noise_mm)
    return build_objective(rig, placement, resolve_constraints(rig, ControlOptions()), prior, moves, options)


def test_a_prior_that_knows_how_controls_change_averages_noise_over_time(toy_rig):
    placement, controls = placed(toy_rig, 12), played(toy_rig, FRAMES)
    noise = 0.5 * torch.randn(FRAMES, 12, 3, generator=torch.Generator().manual_seed(3))
    points, options = placement.points(toy_rig(controls)) + noise, TrackingOptions(noise_mm=0.5)
    plain = learn_prior(toy_rig, played(toy_rig, 60), "itself")
    takes = [Take(played(toy_rig, 60), (), torch.arange(60), 30.0)]
    errors = []
    for prior in (plain, with_changes(plain, toy_rig, takes)):
        constraints = resolve_constraints(toy_rig, ControlOptions())
        objective = build_objective(toy_rig, placement, constraints, prior, False, options, 30.0)
        found = track_markers(objective, points, torch.arange(FRAMES), SolverOptions(), 0.5)
        errors.append(mesh_error(toy_rig, found, controls))
    assert errors[1] < 0.8 * errors[0]


def track(objective: MarkerObjective, points: torch.Tensor, noise_mm: float = 0.1) -> MarkerTrack:
    return track_markers(objective, points, torch.arange(len(points)), SolverOptions(smoothness=0.01, blur=0.5), noise_mm)


def mesh_error(rig, found: MarkerTrack, controls: torch.Tensor) -> float:
    return float((rig(found.controls) - rig(controls)).norm(dim=2).mean())


def turned(points: torch.Tensor) -> torch.Tensor:
    """Points with a rigid motion of each frame."""
    rotation = Rotation.from_euler("xyz", np.linspace(-20, 20, 3 * len(points)).reshape(-1, 3), degrees=True).as_matrix()
    return points @ torch.from_numpy(rotation).to(points).mT + torch.linspace(0, 90, len(points))[:, None, None]


def test_derivatives_of_points_with_offsets_are_those_of_finite_differences():
    corners = torch.randn(5, 3, 3, dtype=torch.float64)
    weights, offset = torch.rand(5, 3, dtype=torch.float64), torch.linspace(-3, 3, 5, dtype=torch.float64)
    found = point_derivatives(corners, weights, offset)
    expected = torch.autograd.functional.jacobian(lambda given: points_on(given, weights, offset), corners)
    each = torch.stack([expected[marker, :, marker] for marker in range(5)])
    assert torch.allclose(found, each, atol=1e-10)


@pytest.mark.parametrize("moves", [False, True])
def test_the_gradient_is_that_of_finite_differences(toy_rig, moves):
    objective = objective_of(toy_rig, placed(toy_rig, 12, 4.0), moves)
    points = turned(objective.placement.points(toy_rig(played(toy_rig, 3))))
    points[1, 4] = torch.nan
    packed, units = pack(points, torch.ones(points.shape[:2])), torch.full((3, 7), 0.4)
    gradient = objective.linearise(units, packed).gradient
    for control in range(7):
        step = 2e-3 * torch.eye(7)[control]
        rise = (objective.cost(units + step, packed) - objective.cost(units - step, packed)) / 4e-3
        assert torch.allclose(rise, gradient[:, control], rtol=0.02, atol=0.02 * float(gradient.abs().max()))


def test_eliminated_motion_equals_the_dense_solve(toy_rig):
    objective = objective_of(toy_rig, placed(toy_rig, 12), True)
    points = turned(objective.placement.points(toy_rig(played(toy_rig, 2))))
    near = objective.derivatives(torch.full((2, 7), 0.4), pack(points, torch.ones(points.shape[:2])))
    moved = near.residuals.points[:, :, None] + 0 * torch.eye(3)
    rows = torch.cat([torch.linalg.cross(torch.eye(3).expand_as(moved), moved), torch.eye(3).expand_as(moved)], dim=2)
    both = torch.cat([near.columns, rows.transpose(2, 3).flatten(1, 2)], dim=2).double()
    dense = both.mT @ both
    schur = dense[:, :7, :7] - dense[:, :7, 7:] @ torch.linalg.solve(dense[:, 7:, 7:], dense[:, 7:, :7])
    assert torch.allclose(
        objective._linearise_data(torch.full((2, 7), 0.4), pack(points, torch.ones(2, 12))).hessian.double(),
        schur,
        rtol=1e-3,
        atol=1e-2,
    )


@pytest.mark.parametrize("moves", [False, True])
def test_controls_are_recovered_with_gaps_and_motion(toy_rig, moves):
    placement, controls = placed(toy_rig, MARKERS, 3.0), played(toy_rig, FRAMES)
    points = placement.points(toy_rig(controls))
    points = turned(points) if moves else points
    points[torch.rand(points.shape[:2]) < 0.1] = torch.nan
    found = track(objective_of(toy_rig, placement, moves), points)
    assert mesh_error(toy_rig, found, controls) < 0.1
    assert not found.stray.any() and not found.swapped.any()
    assert torch.equal(found.residual_mm.isnan(), points.isnan().any(dim=2))


def test_frames_of_few_markers_are_interpolated(toy_rig):
    placement, controls = placed(toy_rig, MARKERS), played(toy_rig, FRAMES)
    points = placement.points(toy_rig(controls))
    points[20:22, 3:] = torch.nan
    found = track(objective_of(toy_rig, placement), points)
    assert (~found.known).nonzero()[:, 0].tolist() == [20, 21]
    assert mesh_error(toy_rig, found, controls) < 0.2


def test_exchanged_labels_are_set_right_and_stray_markers_left_out(toy_rig):
    placement, controls = placed(toy_rig, MARKERS), played(toy_rig, FRAMES)
    points = placement.points(toy_rig(controls)) + 0.1 * torch.randn(FRAMES, MARKERS, 3)
    points[10:15, [4, 30]] = points[10:15, [30, 4]]
    points[12, 30] = torch.nan  # beside a gap
    points[25, 8] += 25.0
    found = track(objective_of(toy_rig, placement), points)
    assert found.swapped.nonzero().tolist() == [
        *([row, marker] for row in (10, 11) for marker in (4, 30)),
        [12, 30],
        *([row, marker] for row in (13, 14) for marker in (4, 30)),
    ]
    assert found.stray.nonzero().tolist() == [[25, 8]]
    assert mesh_error(toy_rig, found, controls) < 0.2


def test_offsets_are_calibrated_from_the_clip(toy_rig):
    true = torch.linspace(3, 7, MARKERS)
    placement, controls = placed(toy_rig, MARKERS).with_offsets(true), played(toy_rig, FRAMES)
    points = placement.points(toy_rig(controls)) + 0.1 * torch.randn(FRAMES, MARKERS, 3)
    unknown = replace(placement.with_offsets(0 * true), calibrated=torch.ones(MARKERS, dtype=torch.bool))
    found = track(objective_of(toy_rig, unknown), points)
    assert float((found.placement.offset_mm - true).abs().mean()) < 0.3
    assert mesh_error(toy_rig, found, controls) < 0.2


def test_the_prior_means_the_same_for_any_number_of_markers(toy_rig):
    few, many = (objective_of(toy_rig, placed(toy_rig, count), noise_mm=0.5) for count in (12, 60))
    assert torch.allclose(few.learned.precision, many.learned.precision, rtol=1e-5)
    expected = 0.25 * learn_prior(toy_rig, played(toy_rig, 60)).precision.float()
    assert torch.allclose(few.learned.precision, expected, rtol=1e-3)


def test_a_map_is_read_as_it_was_written(toy_rig, tmp_path):
    placement = replace(placed(toy_rig, 6, 2.5), names=("nose", "L: brow", "yes", "12", "a#b", "ü"))
    placement.calibrated[2] = True
    write_map(tmp_path / "map.yaml", placement, toy_rig, {"nose": "a comment"})
    found = read_map(tmp_path / "map.yaml", toy_rig)
    assert found.names == placement.names and torch.equal(found.corners, placement.corners)
    assert torch.equal(found.calibrated, placement.calibrated)
    assert torch.allclose(found.points(toy_rig.rest_vertices)[:2], placement.points(toy_rig.rest_vertices)[:2], atol=0.01)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nose: 3", "no markers in it"),
        ("rig: face\nmarkers: {a: {vertex: 1}}", "for rig 'face'"),
        ("markers:\n  a: {vertex: 1}\n  a: {vertex: 2}", "'a' is there twice"),
        ("markers: {a: {vertex: 99999}}", "from 0 to 161"),
        ("markers: {a: {vertex: true}}", "numbers of vertices"),
        ("markers: {a: {triangle: [1, 2]}}", "numbers of vertices"),
        ("markers: {a: {triangle: [1, 2, 3], barycentric: [1, 1, 1]}}", "sum to 3, expected 1"),
        ("markers: {a: {vertex: 1, offset_mm: far}}", "offset_mm 'far'"),
        ("markers: {a: {vertex: 1, triangle: [1, 2, 3]}}", "expected vertex: NUMBER"),
        ("markers: [1]", "no markers in it"),
        ("markers: {", "YAML"),
    ],
)
def test_a_map_that_is_wrong_is_told_in_a_sentence(toy_rig, tmp_path, text, said):
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(InputError, match=said):
        read_map(tmp_path / "map.yaml", toy_rig)


@pytest.mark.parametrize(
    ("policy", "new", "missing"),
    [("error", False, False), ("ignore_new", True, False), ("ignore_missing", False, True), ("ignore_both", True, True)],
)
def test_the_four_policies_for_names_that_do_not_match(toy_rig, policy, new, missing):
    placement = placed(toy_rig, 6)
    for names, accepted in (([*placement.names, "new"], new), (placement.names[:5], missing)):
        clip = MarkerClip(
            "a.csv", tuple(f"actor:{name}" for name in names), np.zeros((2, len(names), 3)), np.arange(2), SourceFacts("CSV")
        )
        if accepted:
            _, shared, notes = matched(clip, placement, "map.yaml", ReadingOptions(unknown=policy))
            assert shared.names == placement.names[: len(names)] and notes
        else:
            with pytest.raises(InputError, match="reading.unknown=ignore_"):
                matched(clip, placement, "map.yaml", ReadingOptions(unknown=policy))


@pytest.mark.parametrize("policy", ["error", "ignore_new", "ignore_both"])
def test_names_of_another_set_of_markers_are_told_as_such(toy_rig, policy):
    """To ignore them, as was suggested, leaves none."""
    placement = placed(toy_rig, 6)
    clip = MarkerClip("a.csv", ("LFHD", "RFHD"), np.zeros((2, 2, 3)), np.arange(2), SourceFacts("CSV"))
    with pytest.raises(InputError, match="0 of its markers are in the map map.yaml, .*'LFHD'.*'m00'.*riginv.markers") as caught:
        matched(clip, placement, "map.yaml", ReadingOptions(unknown=policy))
    assert "ignore" not in str(caught.value)


def test_markers_are_inverted_from_the_command_line(run, toy_rig, tmp_path):
    placement, controls = placed(toy_rig, MARKERS, 2.0), played(toy_rig, FRAMES)
    points = turned(placement.points(toy_rig(controls))).numpy()
    points[5, 3] = np.nan
    points[20:23, [4, 30]] = points[20:23, [30, 4]]
    write_c3d(tmp_path / "take.c3d", placement.names, points / 1000, unit="m")
    write_map(tmp_path / "map.yaml", placement, toy_rig)
    given = ("rig=toy", f"--config-dir={CONF}", f"clip={tmp_path / 'take.c3d'}", f"markers={tmp_path / 'map.yaml'}")
    done = run("invert", *given, "correspondence=markers", "solver.smoothness=0.01", "out=got", "formats=[csv]")
    assert done.code == 0, done.text
    assert "unit m (as the file says)" in done.text and "swapped_labels: 3 frames" in " ".join(done.text.split())
    rows = list(csv.DictReader((tmp_path / "got/curves.csv").read_text().splitlines()))
    found = torch.tensor([[float(row[control.name]) for control in toy_rig.controls] for row in rows])
    assert float((toy_rig(found) - toy_rig(controls)).norm(dim=2).mean()) < 0.5
    facts = json.loads((tmp_path / "got/curves.json").read_text())
    assert [one["name"] for one in facts["markers"]] == list(placement.names)
    assert facts["markers"][4]["swapped"] == 3 and facts["markers"][4]["mean_mm"] < 0.5
    residuals = list(csv.DictReader((tmp_path / "got/marker_residuals.csv").read_text().splitlines()))
    assert residuals[5]["m03"] == "" and float(residuals[6]["m03"]) < 1


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["correspondence=markers"], "needs markers=FILE.yaml"),
        (["markers=map.yaml"], "markers=map.yaml is for correspondence=markers"),
        (["correspondence=markers", "markers=map.yaml", "method=network"], "needs a trained network"),
        (["correspondence=markers", "markers=none.yaml"], "no such file|cannot be read"),
        (["correspondence=markers", "markers=map.yaml", "controls.static=[side]"], "controls.static"),
        (["correspondence=markers", "markers=map.yaml", "solver.fewer_controls=true"], "not markers: leave it out"),
    ],
)
def test_a_command_that_cannot_be_done_leaves_nothing_behind(run, toy_rig, tmp_path, more, said):
    placement = placed(toy_rig, 8)
    write_c3d(tmp_path / "take.c3d", placement.names, placement.points(toy_rig(played(toy_rig, 4))).numpy())
    write_map(tmp_path / "map.yaml", placement, toy_rig)
    done = run("invert", "rig=toy", f"--config-dir={CONF}", "clip=take.c3d", "out=got", *more)
    assert done.code == 1 and "Traceback" not in done.text
    assert any(part in " ".join(done.text.split()) for part in said.split("|")), done.text
    assert not (tmp_path / "got").exists()
