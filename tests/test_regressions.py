"""The parts of the regressions and of the blendshape lookup, against NumPy and SciPy."""

import numpy as np
import pytest
import torch
from scipy.optimize import lsq_linear

from riginv.geometry.neighbours import spread_points
from riginv.methods.baselines.blendshape_weights import BlendshapeWeights
from riginv.methods.baselines.clusters import _threshold, control_reach, find_clusters
from riginv.methods.baselines.control_lookup import ControlLookup
from riginv.methods.baselines.gaussian_process import GaussianProcess, PrincipalComponents
from riginv.methods.baselines.sides import Sides
from riginv.rig.batches import generator_at
from riginv.solvers.bounded import bounded_least_squares


def noise(*shape: int, place: str = "regressions") -> torch.Tensor:
    return torch.randn(*shape, generator=generator_at(0, place), dtype=torch.float64)


def kriging(inputs: np.ndarray, outputs: np.ndarray, at: np.ndarray, scale: float, width: float, noise: float) -> np.ndarray:
    """Universal kriging with a constant, as a textbook has it."""

    def kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return -np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=2) / scale**2 + width**2)

    count = len(inputs)
    system = np.zeros((count + 1, count + 1))
    system[:count, :count] = kernel(inputs, inputs) + noise * np.eye(count)
    system[:count, count] = system[count, :count] = 1
    weights = np.linalg.solve(system, np.vstack([outputs, np.zeros((1, outputs.shape[1]))]))
    return kernel(at, inputs) @ weights[:-1] + weights[-1]


def test_a_gaussian_process_is_kriging_and_its_left_out_error_is_that_of_leaving_out(monkeypatch):
    monkeypatch.setattr("riginv.methods.baselines.gaussian_process.WIDTHS", (1.0,))
    monkeypatch.setattr("riginv.methods.baselines.gaussian_process.NOISES", (1e-2,))
    inputs = noise(25, 3)
    outputs = torch.stack([inputs[:, 0].sin(), inputs[:, 1] * inputs[:, 2]], dim=1)
    process, at = GaussianProcess(inputs, outputs), noise(7, 3, place="at")
    expected = kriging(inputs.numpy(), outputs.numpy(), at.numpy(), process.scale, 1.0, 1e-2)
    np.testing.assert_allclose(process(at).numpy(), expected, atol=1e-8)
    errors = []
    for row in range(25):
        others = np.arange(25) != row
        found = kriging(
            inputs.numpy()[others], outputs.numpy()[others], inputs.numpy()[row : row + 1], process.scale, 1.0, 1e-2
        )
        errors.append(found[0] - outputs.numpy()[row])
    assert process.left_out == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-6)


def test_principal_components_keep_distances(toy):
    samples = noise(40, 6) * torch.tensor([10, 5, 3, 1e-4, 1e-4, 1e-4])
    components = PrincipalComponents(samples, 0.999)
    assert components(samples).shape == (40, 3)
    torch.testing.assert_close(
        torch.cdist(components(samples), components(samples)), torch.cdist(samples, samples), atol=1e-2, rtol=0
    )
    view = noise(6, 9, place="view")
    seen = PrincipalComponents(samples, 1.0, view)(samples)
    torch.testing.assert_close(torch.cdist(seen, seen), torch.cdist(samples @ view, samples @ view), atol=1e-6, rtol=1e-6)


def test_samples_far_apart_are_chosen_first():
    line = torch.tensor([0.0, 0.1, 0.2, 5.0, 5.1, 10.0])[:, None]
    assert spread_points(line, 3).tolist() == [3, 0, 5] and len(spread_points(line, 99)) == 6


def test_clusters_find_vertices_that_move_together():
    reach = torch.zeros(30, 5)
    reach[:10, 0], reach[10:20, 1], reach[10:20, 2], reach[:10, 3] = 5.0, 4.0, 3.0, 0.1
    clusters = find_clusters(reach, 3, seed=0)
    found = {tuple(cluster.controls.tolist()): cluster.vertices.tolist() for cluster in clusters}
    assert found[(1, 2)] == list(range(10, 20))
    assert next(vertices for controls, vertices in found.items() if 0 in controls) == list(range(10))
    assert 4 not in {control for controls in found for control in controls}  # it moves nothing
    assert 3 in {control for controls in found for control in controls}  # nobody took it, but it moves something


def test_the_reach_of_controls_is_measured(toy):
    reach = control_reach(toy)
    for control in (0, 5):
        moved = []
        for value in {float(toy.source.lower[control]), float(toy.source.upper[control])}:
            controls = toy.source.neutral_controls.clone()
            controls[control] = value
            moved.append((toy.source(controls[None])[0] - toy.source.rest_vertices).norm(dim=1))
        torch.testing.assert_close(reach[:, control], torch.stack(moved).amax(dim=0), atol=1e-3, rtol=1e-3)


def test_the_threshold_splits_in_two_as_no_other_does():
    values = np.array([0.1, 0.2, 0.15, 3.0, 4.0, 0.3])
    assert 0.3 < _threshold(values) < 3.0
    assert (np.full(4, 2.0) > _threshold(np.full(4, 2.0))).all()


@pytest.mark.parametrize("spread", [1.0, 1e-3])
def test_bounded_least_squares_is_scipys(spread):
    matrix = noise(30, 12) * torch.logspace(0, np.log10(spread), 12, dtype=torch.float64)
    targets = noise(20, 30, place="targets") * 3
    gram = matrix.T @ matrix + 1e-6 * torch.eye(12, dtype=torch.float64)
    found = bounded_least_squares(gram, targets @ matrix)
    stacked = np.vstack([matrix.numpy(), 1e-3 * np.eye(12)])
    for row in range(20):
        expected = lsq_linear(stacked, np.append(targets[row].numpy(), np.zeros(12)), bounds=(0, 1), method="bvls", tol=1e-14)
        np.testing.assert_allclose(found[row].numpy(), expected.x, atol=1e-5)
    assert found.min() >= 0 and found.max() <= 1


def test_bounded_least_squares_ends_where_no_weight_wants_to_move(face):
    """Shapes that overlap, as a face's do: a guess at which weights end at a limit goes round in circles there."""
    shapes = torch.stack(list(face.arkit_deltas().values())).flatten(1).double()
    gram = shapes @ shapes.T
    gram.diagonal().mul_(1 + 1e-5)
    controls = (
        face.lower + (face.upper - face.lower) * torch.rand(300, len(face.controls), generator=generator_at(0, "controls")) ** 3
    )
    right = (face(controls) - face.rest_vertices).flatten(1).double() @ shapes.T
    found = bounded_least_squares(gram, right)
    gradient = found @ gram - right
    wanted = torch.where(found <= 0, gradient.clamp(max=0), torch.where(found >= 1, gradient.clamp(min=0), gradient))
    assert wanted.abs().max() < 1e-6 * right.abs().max()


def test_the_lookup_brings_single_controls_back(toy):
    sides = Sides(toy.source)
    lookup = ControlLookup(toy)
    for side in range(len(sides) - 1):  # the last one is a macro
        weights = torch.zeros(5, len(sides), dtype=torch.float64)
        weights[:, side] = torch.linspace(0.1, 1, 5)
        controls = sides.controls(weights)
        found = lookup(toy.source.coefficients(controls)[:, :8].double())
        torch.testing.assert_close(found[:, sides.control[side]], controls[:, sides.control[side]], atol=5e-3, rtol=0)


def test_blendshape_weights_of_primaries_alone_are_exact(toy):
    method = BlendshapeWeights(toy, ridge=1e-11)
    method.prepare(0)
    weights = torch.rand(6, 8, generator=generator_at(0, "primaries"))
    found = method.weights(weights @ toy.linear_map[:8])
    torch.testing.assert_close(found.float(), weights, atol=1e-3, rtol=0)
