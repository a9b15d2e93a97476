"""Clips with frames missing: smoothness goes by time, begins anew across long gaps, and roughness counts none of them."""

import math

import pytest
import torch

from riginv.meshes.metrics import roughness
from riginv.rig.batches import generator_at
from riginv.solvers.band import LONGEST_GAP, second_difference_bands, second_differences, spans, usual_steps
from riginv.solvers.clip import smoothed, solve_clip
from riginv.solvers.levenberg_marquardt import Solution
from riginv.solvers.objective import Objective
from riginv.tracking.alternation import interpolate_controls
from tests.solvers.test_solvers import moving
from tests.support.inverting import inverted
from tests.support.toys import ToyRig

FAR = 200  # frames, of a gap that is too long to be smooth across


def test_second_differences_go_by_time():
    """Of a straight line they are 0 however it is sampled, and of a parabola the integral of its squared second derivative."""
    numbers = torch.tensor([0, 1, 2, 4, 5, 8, 9, 10, 11, 12])
    weights = second_differences(usual_steps(numbers))
    for curve, expected in ((3.0 * numbers - 7, 0.0), (0.5 * numbers.double() ** 2, 1.0)):
        found = torch.stack([(weights[row] * curve[row : row + 3].double()).sum() for row in range(len(weights))])
        spans_s = (numbers[2:] - numbers[:-2]).double() / 2
        torch.testing.assert_close(found.square(), expected * spans_s)
    assert torch.equal(second_differences(torch.ones(4, dtype=torch.float64)), torch.tensor([[1.0, -2.0, 1.0]] * 3).double())


@pytest.mark.parametrize("step", [1, 10])
def test_only_gaps_that_are_long_for_the_clip_are_gaps(step):
    numbers = step * torch.cat([torch.arange(5), FAR + torch.arange(4), 2 * FAR + 2 * torch.arange(3)])
    assert [(rows.start, rows.stop) for rows in spans(numbers)] == [(0, 5), (5, 9), (9, 12)]
    assert spans(step * torch.arange(7)) == [slice(0, 7)] and spans(torch.arange(1)) == [slice(0, 1)]
    weights = second_differences(usual_steps(numbers))
    assert (weights[3:5] == 0).all() and (weights[7:9] == 0).all() and (weights[:3] != 0).all()
    assert usual_steps(torch.tensor([0, 1, 2 + int(LONGEST_GAP), 3 + int(LONGEST_GAP)])).max() == LONGEST_GAP + 1


def test_the_bands_are_those_of_the_differences():
    weights = second_differences(usual_steps(torch.tensor([0, 1, 3, 4, 5, 7, 8])))
    rows = torch.zeros(5, 7, dtype=torch.float64)
    for row in range(5):
        rows[row, row : row + 3] = weights[row]
    square = (rows.T @ rows)[2:, 2:]
    for offset, band in enumerate(second_difference_bands(5, 2, weights)):
        torch.testing.assert_close(band[: 5 - offset], square.diagonal(offset))


def test_a_clip_with_a_gap_is_two_clips(toy):
    objective = Objective(toy)
    controls, coordinates = moving(toy, 80)
    start = objective.units(controls)
    parts = [solve_clip(objective, coordinates[rows], start[rows], 1.0, 8) for rows in (slice(0, 40), slice(40, 80))]
    numbers = torch.cat([torch.arange(40), FAR + torch.arange(40)])
    with_gap = solve_clip(objective, coordinates, start, 1.0, 8, numbers=numbers, tolerance=0)
    without = solve_clip(objective, coordinates, start, 1.0, 8)
    torch.testing.assert_close(with_gap, torch.cat(parts), atol=2e-3, rtol=0)
    assert torch.equal(solve_clip(objective, coordinates, start, 1.0, 8, numbers=torch.arange(80)), without)
    jumping = coordinates.clone()
    jumping[40:] = coordinates[40:].flip(0)
    coupled, apart = (solve_clip(objective, jumping, start, 5.0, 8, numbers=one) for one in (None, numbers))
    costs = [float(objective.cost(units, jumping)[36:44].mean()) for units in (coupled, apart)]
    assert costs[1] < 0.9 * costs[0]  # nothing drags the frames beside the jump towards each other


def test_a_few_missing_rows_leave_a_curve_as_it_is(toy):
    """What one row in eight of a smooth clip says of its neighbours is what the whole clip says."""
    objective = Objective(toy)
    controls, coordinates = moving(toy, 80)
    start = objective.units(controls)
    kept = torch.tensor([row for row in range(80) if row % 8 != 5])
    whole = solve_clip(objective, coordinates, start, 1.0, 8)[kept]
    by_time, by_row = (solve_clip(objective, coordinates[kept], start[kept], 1.0, 8, numbers=one) for one in (kept, None))
    assert (by_time - whole).square().mean() < (by_row - whole).square().mean()


def test_a_blur_does_not_reach_across_a_gap(toy):
    units = torch.cat([torch.zeros(10, 7), torch.ones(10, 7)])
    solution = Solution.at_neutral(Objective(toy), 20)
    solution.units, solution.skipped = units, torch.zeros(20, dtype=torch.bool)
    assert (smoothed(solution, 3.0) - units).abs().max() > 0.3
    numbers = torch.cat([torch.arange(10), FAR + torch.arange(10)])
    torch.testing.assert_close(smoothed(solution, 3.0, numbers), units)


def test_roughness_counts_no_gap():
    curve = torch.cat([torch.arange(10.0), 100 + torch.arange(10.0)])[:, None]
    numbers = torch.cat([torch.arange(10), FAR + torch.arange(10)])
    assert roughness(curve) > 100 and roughness(curve, numbers) == 0 and roughness(curve[:10], 3 * numbers[:10]) == 0
    assert math.isnan(roughness(curve[:2])) and math.isnan(roughness(curve[:3], torch.tensor([0, 1, 7])))


def test_a_bridge_goes_by_time():
    known, values = torch.tensor([True, False, True]), torch.tensor([[0.0], [9.0], [10.0]])
    assert float(interpolate_controls(values, known, torch.tensor([0, 9, 10]))[1]) == pytest.approx(9)
    assert float(interpolate_controls(values, known, torch.arange(3))[1]) == pytest.approx(5)


def test_invert_solves_both_sides_of_a_gap_for_themselves():
    """A take whose face was lost for seconds: the pose before the gap is not drawn towards the one after it."""
    rig = ToyRig()
    controls = torch.zeros(24, 7)
    controls[12:] = 0.7
    with torch.no_grad():
        meshes = rig(controls)
    meshes = meshes + 0.2 * torch.randn(meshes.shape, generator=generator_at(0, "gap"))
    numbers = torch.cat([torch.arange(12), FAR + torch.arange(12)]).numpy()
    errors = []
    for given in (None, numbers):
        found = inverted(rig, meshes, method="clip", numbers=given)
        errors.append(float((found.controls[10:14] - controls[10:14]).abs().mean()))
    assert errors[1] < 0.7 * errors[0]
