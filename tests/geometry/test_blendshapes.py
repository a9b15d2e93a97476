"""Screening, combinations and deltas against plain loops."""

import numpy as np
import torch

from riginv.geometry.blendshapes import apply_deltas, combination_weights, screen, smallest_weights


def test_screen_is_the_complement_of_the_product_of_complements():
    draw = np.random.default_rng(0)
    activations = draw.random((5, 6))
    sources = [[0, -1, -1], [1, 2, -1], [3, 4, 5]]
    expected = [[1 - np.prod([1 - row[i] for i in slots if i >= 0]) for slots in sources] for row in activations]
    found = screen(torch.from_numpy(activations), torch.tensor(sources))
    np.testing.assert_allclose(found, expected, atol=1e-15)


def test_combinations_are_products_or_the_least_weight():
    draw = np.random.default_rng(1)
    weights = draw.random((4, 7))
    members = [[0, 1, -1, -1], [2, 5, 6, -1], [3, 4, 0, 1]]
    for combine, rule in ((combination_weights, np.prod), (smallest_weights, np.min)):
        expected = [[rule([row[i] for i in group if i >= 0]) for group in members] for row in weights]
        found = combine(torch.from_numpy(weights), torch.tensor(members))
        np.testing.assert_allclose(found, expected, atol=1e-15)


def test_deltas_add_up():
    draw = np.random.default_rng(2)
    rest, deltas, weights = draw.normal(size=(9, 3)), draw.normal(size=(4, 9, 3)), draw.random((5, 4))
    expected = [rest + sum(w * delta for w, delta in zip(row, deltas)) for row in weights]
    found = apply_deltas(torch.from_numpy(rest), torch.from_numpy(deltas), torch.from_numpy(weights))
    np.testing.assert_allclose(found, expected, atol=1e-12)
