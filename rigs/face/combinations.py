"""Combinations: shapes that repair what two or three primary shapes do together.

Where shapes push the same skin the same way, their sum overshoots: skin gives only so far. A combination takes back what
exceeds the `ORDER`-norm of the pushes, vertex by vertex.
"""

from itertools import combinations

import numpy as np

PAIRS, TRIPLES = 264, 80
PAIRS_PER_SHAPE, TRIPLES_PER_SHAPE = 9, 6
ORDER = 2.5
SAMPLE = 8  # every so manieth vertex decides which combinations are worth having
SHORTLIST = 2000  # pairs that share the most moving skin, among which the overshoot decides


def choose_combinations(primaries: dict[str, np.ndarray], together: list[set[str]], apart: set[str]) -> list[tuple[str, ...]]:
    """The combinations that repair the most, spread over the shapes: the names of the two or three shapes of each.

    Args:
        primaries: deltas `(vertex, 3)`, mm, by name.
        together: sets of shapes that one control moves as one; no combination lies within a set.
        apart: shapes that take no part in combinations.
    """
    names = [name for name in primaries if name not in apart]
    sampled = {name: primaries[name][::SAMPLE] for name in names}
    within = {pair for group in together for pair in combinations(sorted(group), 2)}
    reach = {name: np.linalg.norm(deltas, axis=1) for name, deltas in sampled.items()}
    shared = {
        pair: float(reach[pair[0]] @ reach[pair[1]]) for pair in combinations(names, 2) if tuple(sorted(pair)) not in within
    }
    candidates = sorted(shared, key=lambda pair: -round(shared[pair], 6))[:SHORTLIST]
    pairs = _strongest({pair: overshoot([sampled[name] for name in pair]) for pair in candidates}, PAIRS, PAIRS_PER_SHAPE)

    chosen = set(pairs)
    candidates = [triple for triple in combinations(names, 3) if all(pair in chosen for pair in combinations(triple, 2))]
    triples = _strongest({triple: repair(triple, sampled) for triple in candidates}, TRIPLES, TRIPLES_PER_SHAPE)
    return [*pairs, *triples]


def overshoot(deltas: list[np.ndarray]) -> np.ndarray:
    """What the sum of deltas, each `(vertex, 3)`, must give back at each vertex, `(vertex, 3)`."""
    total = sum(deltas)
    direction = total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-9)
    pushes = np.stack([np.maximum((delta * direction).sum(axis=-1), 0) for delta in deltas])
    excess = pushes.sum(axis=0) - (pushes**ORDER).sum(axis=0) ** (1 / ORDER)
    return -excess[..., None] * direction


def repair(shapes: tuple[str, ...], deltas: dict[str, np.ndarray]) -> np.ndarray:
    """The deltas of a combination: the overshoot of its shapes, less what the pairs among them repair already."""
    result = overshoot([deltas[name] for name in shapes])
    if len(shapes) == 3:
        result -= sum(overshoot([deltas[name] for name in pair]) for pair in combinations(shapes, 2))
    return result


def _strongest(repairs: dict[tuple, np.ndarray], count: int, per_shape: int) -> list[tuple[str, ...]]:
    size = {shapes: round(float((deltas**2).sum()), 6) for shapes, deltas in repairs.items()}
    taken: dict[str, int] = {}
    result = []
    for shapes in sorted(size, key=lambda shapes: -size[shapes]):
        if len(result) < count and all(taken.get(name, 0) < per_shape for name in shapes):
            result.append(shapes)
            taken.update({name: taken.get(name, 0) + 1 for name in shapes})
    return result
