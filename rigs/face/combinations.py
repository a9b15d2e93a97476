"""Combination shapes: corrections of two or three primary shapes that act together.

Where shapes push the same skin in the same direction, their sum overshoots. A combination removes, vertex by vertex, what
exceeds the `ORDER`-norm of the displacements.
"""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

PAIRS, TRIPLES = 264, 80
PAIRS_PER_SHAPE, TRIPLES_PER_SHAPE = 9, 6
ORDER = 2.5
STRIDE = 8  # of the vertices that combinations are chosen by
SHORTLIST = 2000  # pairs with the most moving skin in common, ranked by their overshoot


def choose_combinations(primaries: dict[str, np.ndarray], coupled: list[set[str]], excluded: set[str]) -> list[tuple[str, ...]]:
    """The combinations that correct the most, limited per shape: the names of the two or three shapes of each.

    Args:
        primaries: deltas `(vertex, 3)`, mm, by name.
        coupled: sets of shapes that one control moves as one; no combination is within a set.
        excluded: shapes without combinations.
    """
    names = [name for name in primaries if name not in excluded]
    sampled = {name: primaries[name][::STRIDE] for name in names}
    within = {pair for group in coupled for pair in combinations(sorted(group), 2)}
    sizes = {name: np.linalg.norm(deltas, axis=1) for name, deltas in sampled.items()}
    shared = {
        pair: float(sizes[pair[0]] @ sizes[pair[1]]) for pair in combinations(names, 2) if tuple(sorted(pair)) not in within
    }
    candidates = sorted(shared, key=lambda pair: -round(shared[pair], 6))[:SHORTLIST]
    pairs = _strongest({pair: overshoot([sampled[name] for name in pair]) for pair in candidates}, PAIRS, PAIRS_PER_SHAPE)

    chosen = set(pairs)
    closed = [triple for triple in combinations(names, 3) if all(pair in chosen for pair in combinations(triple, 2))]
    triples = _strongest({triple: repair(triple, sampled) for triple in closed}, TRIPLES, TRIPLES_PER_SHAPE)
    return [*pairs, *triples]


def overshoot(deltas: list[np.ndarray]) -> np.ndarray:
    """The correction `(vertex, 3)` of the sum of deltas, each `(vertex, 3)`."""
    total = sum(deltas, np.zeros_like(deltas[0]))
    direction = total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-9)
    along = np.stack([np.maximum((delta * direction).sum(axis=-1), 0) for delta in deltas])
    excess = along.sum(axis=0) - (along**ORDER).sum(axis=0) ** (1 / ORDER)
    return -excess[..., None] * direction


def repair(shapes: tuple[str, ...], deltas: dict[str, np.ndarray]) -> np.ndarray:
    """Deltas of a combination: the overshoot of its shapes, less the corrections of the pairs among them."""
    result = overshoot([deltas[name] for name in shapes])
    if len(shapes) == 3:
        pairs = (overshoot([deltas[name] for name in pair]) for pair in combinations(shapes, 2))
        result -= sum(pairs, np.zeros_like(result))
    return result


def _strongest(repairs: Mapping[tuple[str, ...], np.ndarray], count: int, per_shape: int) -> list[tuple[str, ...]]:
    size = {shapes: round(float((deltas**2).sum()), 6) for shapes, deltas in repairs.items()}
    taken: dict[str, int] = {}
    result: list[tuple[str, ...]] = []
    for shapes in sorted(size, key=lambda shapes: -size[shapes]):
        if len(result) < count and all(taken.get(name, 0) < per_shape for name in shapes):
            result.append(shapes)
            taken.update({name: taken.get(name, 0) + 1 for name in shapes})
    return result
