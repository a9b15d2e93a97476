"""Approximations that are measured, not fitted: one pose of the rig for every term."""

from collections.abc import Sequence
from itertools import combinations

import torch
from torch import Tensor

from riginv.methods.baselines.product_model import NONE, ProductModel, Terms
from riginv.methods.baselines.sides import Sides
from riginv.rig.mesh_space import RigInMeshSpace

BATCH_SIZE = 512  # poses at a time
MOST_CANDIDATES = 20_000  # of one order that are measured
LEAST_MM = 1e-4  # root mean square over the vertices: terms that move less are left out


def pose_coordinates(rig: RigInMeshSpace, sides: Sides, weights: Tensor) -> Tensor:
    """The mesh coordinates `(pose, coordinate)` of the rig at weights `(pose, side)`, in float64."""
    with torch.no_grad():
        pieces = [rig(sides.controls(piece)).double() for piece in weights.split(BATCH_SIZE)]
    return torch.cat(pieces) if pieces else torch.zeros(0, rig.space.size, dtype=torch.float64)


def ramps(rig: RigInMeshSpace, squares: bool) -> ProductModel:
    """Each side alone, linear in its weight; or quadratic, through its poses at half and at full weight."""
    sides = Sides(rig.source)
    count = torch.arange(len(sides))
    full = pose_coordinates(rig, sides, torch.eye(len(sides), dtype=torch.float64))
    table = torch.tensor([[0.0, 1.0]], dtype=torch.float64).expand(len(sides), 2)
    if not squares:
        return ProductModel(sides, count, table, Terms(count[:, None], full))
    half = pose_coordinates(rig, sides, 0.5 * torch.eye(len(sides), dtype=torch.float64))
    alone = torch.stack([count, torch.full_like(count, NONE)], dim=1)
    members = torch.cat([alone, count[:, None].expand(-1, 2)])
    return ProductModel(sides, count, table, Terms(members, torch.cat([4 * half - full, 2 * full - 4 * half])))


def tables(rig: RigInMeshSpace, pieces: int) -> ProductModel:
    """Each side alone, as a path through `pieces` + 1 of its poses; a curve of it, from 0 to 1, for products to come.

    The last activations, one for each side, are these curves: how far along its full displacement a side has come.
    """
    sides = Sides(rig.source)
    count, knots = len(sides), torch.arange(1, pieces + 1, dtype=torch.float64) / pieces
    poses = (torch.eye(count, dtype=torch.float64)[:, None] * knots[:, None]).flatten(0, 1)
    paths = pose_coordinates(rig, sides, poses).unflatten(0, (count, pieces))
    full = paths[:, -1]
    strength = full.square().sum(dim=1).clamp_min(torch.finfo(torch.float64).tiny)
    curves = torch.einsum("skc,sc->sk", paths, full) / strength[:, None]
    hats = torch.eye(pieces, dtype=torch.float64).repeat(count, 1)
    table = torch.cat([torch.zeros(count * (pieces + 1), 1, dtype=torch.float64), torch.cat([hats, curves])], dim=1)
    side = torch.cat([torch.arange(count).repeat_interleave(pieces), torch.arange(count)])
    return ProductModel(sides, side, table, Terms(torch.arange(count * pieces)[:, None], paths.flatten(0, 1)))


def with_products(rig: RigInMeshSpace, model: ProductModel, counts: Sequence[int]) -> ProductModel:
    """Add what sides do together: the strongest pairs, then triples all of whose pairs are there, and so on.

    The deltas of a product are what the model misses where just its sides are at full weight. The last activations of the
    model, one for each side, are what is multiplied.

    Args:
        counts: how many products of two sides, of three, ... are kept at most.
    """
    sides = model.sides
    first = len(model.side) - len(sides)
    kept: dict[tuple[int, ...], float] = {}
    for order, count in enumerate(counts, start=2):
        chosen = _candidates(sides, kept, order)
        missed = torch.cat([_missed(rig, model, piece).norm(dim=1) for piece in chosen.split(BATCH_SIZE)] or [torch.zeros(0)])
        best = missed.argsort(descending=True, stable=True)[:count]
        best = best[missed[best] > LEAST_MM * rig.space.vertex_count**0.5]
        if not len(best):
            break
        kept = dict(zip(map(tuple, chosen[best].tolist()), missed[best].tolist()))
        model = model.extended(Terms(first + chosen[best], _missed(rig, model, chosen[best])))
    return model


def _missed(rig: RigInMeshSpace, model: ProductModel, chosen: Tensor) -> Tensor:
    weights = torch.zeros(len(chosen), len(model.sides), dtype=torch.float64).scatter_(1, chosen, 1.0)
    return pose_coordinates(rig, model.sides, weights) - model.coordinates(weights)


def _candidates(sides: Sides, kept: dict[tuple[int, ...], float], order: int) -> Tensor:
    """Sets of `order` sides of different controls, `(candidate, order)`, that may do something together."""
    control = sides.control.tolist()
    if order == 2:
        found = [pair for pair in combinations(range(len(sides)), 2) if control[pair[0]] != control[pair[1]]]
        return torch.tensor(found, dtype=torch.long).reshape(-1, 2)
    partners: dict[tuple[int, ...], list[int]] = {}
    for subset in kept:
        partners.setdefault(subset[:-1], []).append(subset[-1])
    strengths: dict[tuple[int, ...], float] = {}
    for start, ends in partners.items():
        for pair in combinations(sorted(ends), 2):
            candidate = (*start, *pair)
            parts = list(combinations(candidate, order - 1))
            if all(part in kept for part in parts):
                strengths[candidate] = sum(kept[part] for part in parts)
    strongest = sorted(strengths, key=lambda candidate: -strengths[candidate])[:MOST_CANDIDATES]
    return torch.tensor(strongest, dtype=torch.long).reshape(-1, order)
