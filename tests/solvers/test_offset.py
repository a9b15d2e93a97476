"""A static offset with the controls of many frames: the elimination against dense systems, and recovery."""

import pytest
import torch

from riginv.rig.batches import generator_at
from riginv.rig.interface import Control, LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.objective import Objective
from riginv.solvers.offset import Arrow, OffsetSolver
from tests.support.toys import ToyRig


class Plain(LinearRig):
    """The toy's mesh with five shapes that controls weight directly."""

    def __init__(self) -> None:
        toy = ToyRig()
        super().__init__("plain", [Control(f"c{i}") for i in range(5)], toy.rest_vertices, toy.faces, toy.basis[:5])

    def coefficients(self, controls: torch.Tensor) -> torch.Tensor:
        return controls


def strokes(frames: int, controls: int) -> torch.Tensor:
    """Controls that are at rest most of the time."""
    time, centre = torch.linspace(0, 1, frames)[:, None], torch.linspace(0.1, 0.9, controls)
    return (0.8 * torch.exp(-0.5 * ((time - centre) / 0.07) ** 2) - 0.02).clamp_min(0)


def test_elimination_is_the_dense_solve():
    frames, unknowns, shared = 6, 5, 9
    random = generator_at(0, "arrow")
    rows = torch.randn(frames, 12, unknowns, generator=random, dtype=torch.float64)
    couples = torch.randn(12, shared, generator=random, dtype=torch.float64)
    gradient = torch.randn(frames, unknowns, generator=random, dtype=torch.float64)
    slope = torch.randn(shared, generator=random, dtype=torch.float64)
    arrow = Arrow(rows.mT @ rows, gradient, rows.mT @ couples, frames * couples.T @ couples, slope, unknowns)
    added = torch.rand(frames, unknowns, generator=random, dtype=torch.float64) + 0.1
    free = torch.rand(frames, unknowns, generator=random) > 0.3
    pinned = torch.where(free, 0.0, torch.randn(frames, unknowns, generator=random, dtype=torch.float64))
    found, field = arrow.solve(added, free, pinned)

    size = frames * unknowns
    matrix = torch.zeros(size + shared, size + shared, dtype=torch.float64)
    for frame in range(frames):
        some = slice(frame * unknowns, (frame + 1) * unknowns)
        matrix[some, some] = arrow.hessian[frame] + torch.diag(added[frame])
        matrix[some, size:] = arrow.coupling[frame]
        matrix[size:, some] = arrow.coupling[frame].T
    matrix[size:, size:] = arrow.own
    right = -torch.cat([gradient.flatten(), slope])
    solved = torch.cat([free.flatten(), torch.ones(shared, dtype=torch.bool)])
    given = torch.cat([pinned.flatten(), torch.zeros(shared, dtype=torch.float64)])
    without = right - (matrix - torch.diag(torch.cat([added.flatten(), torch.zeros(shared, dtype=torch.float64)]))) @ given
    dense = given.clone()
    dense[solved] = torch.linalg.solve(matrix[solved][:, solved], without[solved])
    torch.testing.assert_close(found.flatten(), dense[:size], rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(field, dense[size:], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("moves", [False, True])
def test_field_and_controls_are_found_together(moves):
    """A linear rig: an unknown neutral 2 mm off, and frames that stand still or are tilted by up to 3 degrees."""
    rig, truth = Plain(), strokes(40, 5)
    offset = 2 * torch.sin(rig.rest_vertices / 20).roll(1, dims=1)
    vertices = rig(truth) + offset
    if moves:
        angles = 0.05 * torch.sin(torch.arange(40.0))
        cross = torch.linalg.cross(torch.eye(3)[None], angles[:, None, None] * torch.tensor([0.6, 0.8, 0.0]).expand(40, 3, 3))
        vertices = vertices @ torch.matrix_exp(cross).mT
    objective = Objective(RigInMeshSpace(rig, MeshSpace.from_rig(rig)), sparsity=1e-4)
    found = OffsetSolver(objective, moves, is_free=True).solve(vertices, vertices.mean(dim=0), 40)
    assert float((found.units - truth).abs().mean()) < 0.002
    field = found.neutral - rig.rest_vertices - offset
    assert float((field - field.mean(dim=0)).norm(dim=1).mean()) < 0.05
    turns = OffsetSolver(objective, moves, is_free=True).solve(vertices, vertices.mean(dim=0), 0)
    assert found.cost < 0.1 * turns.cost


def test_controls_are_exact_on_a_linear_rig_with_the_neutral_given():
    rig, truth = Plain(), strokes(20, 5)
    neutral = rig.rest_vertices + 2 * torch.sin(rig.rest_vertices / 20).roll(1, dims=1)
    vertices = neutral + rig(truth) - rig.rest_vertices
    objective = Objective(RigInMeshSpace(rig, MeshSpace.from_rig(rig)), prior=1e-9)
    found = OffsetSolver(objective, False, is_free=False).solve(vertices, neutral, 20)
    torch.testing.assert_close(found.units, truth, rtol=0, atol=1e-4)
    torch.testing.assert_close(found.neutral, neutral, rtol=0, atol=1e-3)


def test_unknown_vertices_do_not_count():
    rig, truth = Plain(), strokes(40, 5)
    vertices = rig(truth) + 1.5
    vertices[::3, 5:40] = torch.nan
    objective = Objective(RigInMeshSpace(rig, MeshSpace.from_rig(rig)), sparsity=1e-4)
    found = OffsetSolver(objective, False, is_free=True).solve(vertices, rig.rest_vertices, 60)
    assert bool(torch.isfinite(found.neutral).all()) and float((found.units - truth).abs().mean()) < 0.01
