"""A clip solved with the covariance of the controls' second differences."""

import torch

from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.band import second_difference_bands
from riginv.solvers.band_step import band_box_step
from riginv.solvers.clip import solve_clip
from riginv.solvers.objective import Objective
from tests.support.toys import ToyRig

FRAMES, CONTROLS = 9, 4


def random_covariance(size: int, seed: int) -> torch.Tensor:
    root = torch.randn(size, size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return root @ root.T + 0.1 * torch.eye(size, dtype=torch.float64)


def test_the_step_solves_the_dense_system_of_coupled_controls():
    blocks = torch.stack([random_covariance(CONTROLS, frame) for frame in range(FRAMES)])
    covariance, generator = random_covariance(CONTROLS, 50), torch.Generator().manual_seed(51)
    gradient = 1e-3 * torch.randn(FRAMES, CONTROLS, generator=generator, dtype=torch.float64)
    at, added = torch.full_like(gradient, 0.5), torch.full_like(gradient, 0.2)
    bands = second_difference_bands(FRAMES)
    difference = torch.eye(FRAMES, dtype=torch.float64).diff(n=2, dim=0)
    dense = torch.kron((difference.T @ difference).contiguous(), torch.linalg.inv(covariance).contiguous())
    dense += torch.block_diag(*(blocks + torch.diag_embed(added)))
    main, near, far = bands
    root = torch.linalg.cholesky(covariance)
    found = band_box_step(blocks, added, near, far, gradient, at, main=main, root=root)
    torch.testing.assert_close(found.flatten(), torch.linalg.solve(dense, -gradient.flatten()))
    at[:, 1] = 0.0
    gradient[:, 1] = 10.0  # these controls stay at their limit, and the others are solved for
    found = band_box_step(blocks, added, near, far, gradient, at, main=main, root=root)
    free = (torch.arange(FRAMES * CONTROLS) % CONTROLS) != 1
    expected = torch.linalg.solve(dense[free][:, free], -gradient.flatten()[free])
    torch.testing.assert_close(found.flatten()[free], expected, rtol=1e-4, atol=1e-8)
    assert bool((found[:, 1].abs() < 1e-6).all())


def test_equal_independent_changes_are_plain_smoothness_and_still_controls_become_still():
    rig = ToyRig()
    objective = Objective(RigInMeshSpace(rig, MeshSpace.from_rig(rig)))
    phase = torch.linspace(0, 6, 30)[:, None] * torch.arange(1, 8) + torch.arange(7)
    units = 0.5 + 0.3 * torch.sin(phase)
    coordinates = objective.rig.space.encode(rig(objective.to_controls(units)))
    coordinates += 0.3 * torch.randn(coordinates.shape, generator=torch.Generator().manual_seed(1))
    plain = solve_clip(objective, coordinates, units, 0.05, 20, tolerance=0)
    same = solve_clip(objective, coordinates, units, 0.1, 20, tolerance=0, changes=2 * torch.eye(7))
    torch.testing.assert_close(same, plain, atol=2e-4, rtol=0)
    still = torch.diag(torch.tensor([1e-6, *[2.0] * 6]))
    found = solve_clip(objective, coordinates, units, 0.1, 20, tolerance=0, changes=still)
    assert found[:, 0].diff(n=2).abs().max() < 0.1 * plain[:, 0].diff(n=2).abs().max()
