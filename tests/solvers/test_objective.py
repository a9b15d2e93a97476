"""The objective of the solvers: weights, sparsity, the mean distance."""

import torch

from riginv.inference.inverse import Inverse
from riginv.networks.inverse import DirectInverse
from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.clip import solve_clip
from riginv.solvers.every_mesh import refine_meshes, solve_meshes
from riginv.solvers.levenberg_marquardt import levenberg_marquardt
from riginv.solvers.objective import Objective
from tests.solvers.test_solvers import mesh_error_mm, moving, poses
from tests.support.toys import ToyRig


def test_weights_say_what_a_mesh_counts_against_the_prior(toy):
    objective, coordinates = Objective(toy, prior=0.5), toy(poses(toy.source, 6))
    start = objective.units(poses(toy.source, 6, "start"))
    plain = levenberg_marquardt(objective, coordinates, start, 40)
    weights = torch.tensor([1.0, 1, 1, 0, 100, 1e-4])
    found = levenberg_marquardt(objective, coordinates, start, 40, weights=weights)
    torch.testing.assert_close(found.units[:3], plain.units[:3], atol=1e-5, rtol=0)
    torch.testing.assert_close(found.units[3], objective.neutral, atol=1e-3, rtol=0)
    missed = [(toy(objective.to_controls(one.units)) - coordinates).norm(dim=1) for one in (plain, found)]
    assert missed[1][4] < 0.5 * missed[0][4] and missed[1][5] > missed[0][5]


def test_a_frame_that_does_not_count_follows_its_neighbours(toy):
    objective = Objective(toy)
    controls, coordinates = moving(toy, 40)
    start, spoiled = objective.units(controls), coordinates.clone()
    spoiled[20] += 5
    trusted = torch.ones(40)
    trusted[20] = 0
    plain, wrong, right = (
        solve_clip(objective, one, start, 1.0, weights=weights)
        for one, weights in ((coordinates, None), (spoiled, None), (spoiled, trusted))
    )
    assert (right[20] - plain[20]).abs().max() < 0.2 * (wrong[20] - plain[20]).abs().max()


def test_sparsity_leaves_fewer_controls_in_use(toy):
    coordinates = toy(poses(toy.source, 20)) + 0.5 * torch.randn(20, toy.space.size, generator=generator_at(0, "noise"))
    used = []
    for sparsity in (0.0, 0.05):
        objective = Objective(toy, sparsity=sparsity)
        used.append(int(((solve_meshes(objective, coordinates).units - objective.neutral).abs() > 1e-2).sum()))
    assert used[1] < 0.9 * used[0]


def test_refinement_improves_on_an_untrained_network(toy):
    controls = poses(toy.source, 10)
    network = DirectInverse(toy, hidden=[8]).eval()
    meshes = toy.source(controls)
    plain, refined = (mesh_error_mm(toy.source, Inverse(network, steps)(meshes), controls).mean() for steps in (0, 8))
    assert refined < 0.3 * plain
    start = Objective(toy).units(network(toy(controls)).detach())
    assert refine_meshes(Objective(toy), toy(controls), start, 8).steps.max() <= 8


def test_the_mean_distance_is_what_it_says_and_so_is_its_gradient(toy):
    """Against the vertices themselves, and against finite differences in float64."""
    rig = ToyRig().double()
    objective = Objective(RigInMeshSpace(rig, MeshSpace.from_rig(rig)), prior=0.0).by_mean_distance(corner_mm=0.2)
    units = 0.1 + 0.8 * torch.rand(3, 7, generator=generator_at(0, "units"), dtype=torch.float64)
    target = rig(objective.to_controls(units.flip(0)))
    coordinates = objective.rig.space.encode(target)
    distance = (rig(objective.to_controls(units)) - target).norm(dim=2)
    expected = (0.2 * ((distance.square() + 0.2**2).sqrt() - 0.2)).sum(dim=1)
    torch.testing.assert_close(objective.cost(units, coordinates), expected)
    gradient, step = objective.gradient(units, coordinates), 1e-6
    for control in range(7):
        moved = units.clone()
        moved[:, control] += step
        derivative = (objective.cost(moved, coordinates) - objective.cost(units, coordinates)) / step
        torch.testing.assert_close(derivative, gradient[:, control], rtol=1e-3, atol=1e-3)


def test_steps_on_the_mean_distance_lower_it(toy):
    objective = Objective(toy)
    controls, coordinates = moving(toy, 60)
    wild = toy.space.decode(coordinates)
    wild[:, ::9] += 3.0  # what a capture got wrong, everywhere at the same places
    coordinates = toy.space.encode(wild)
    start = objective.units(controls)

    def mean_distance_mm(units):
        return (toy.source(objective.to_controls(units)) - toy.space.decode(coordinates)).norm(dim=2).mean()

    squares = solve_clip(objective, coordinates, start, 1e-3, 12)
    means = solve_clip(objective, coordinates, start, 1e-3, 12, mean_steps=12)
    assert mean_distance_mm(means) < 0.99 * mean_distance_mm(squares)
    again = solve_clip(objective, coordinates, start, 1e-3, 12, mean_steps=0)
    assert torch.equal(again, squares)
