"""Regions of a rig's mesh by name: to weigh vertices by, and to say where a frame is worst."""

import json
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import RANK_TOLERANCE, MeshSpace
from riginv.runs.array_files import check_npy

STEMS = ("brow", "eye", "cheek", "nose", "mouth", "jaw", "tongue")  # of ARKit's shapes
STILL = "still"
LITTLE = 0.02  # of what a shape moves at most: vertices that move less belong to no region of the face


def regions_of(rig: RigBackend) -> dict[str, Tensor]:
    """The regions that a rig tells of itself, `(vertex,)` whether a vertex belongs; no vertex is in two of them.

    Those of a skeleton are its joints. Those of a face are named by the ARKit shapes that move a vertex most; what none moves
    is `still`. Empty where a rig has neither.
    """
    skeleton = rig.skeleton()
    if skeleton is not None:
        strongest = skeleton.weights.argmax(dim=1)
        return {name: found for number, name in enumerate(skeleton.joint_names) if bool((found := strongest == number).any())}
    shapes = rig.arkit_deltas()
    moved = {stem: [delta.norm(dim=1) for name, delta in shapes.items() if name.startswith(stem)] for stem in STEMS}
    ways = {stem: torch.stack(found).amax(dim=0) for stem, found in moved.items() if found}
    if not ways:
        return {}
    shares = torch.stack([way / way.max().clamp_min(1e-9) for way in ways.values()])
    strongest = torch.where(shares.amax(dim=0) > LITTLE, shares.argmax(dim=0), -1)
    names = {STILL: -1, **{name: number for number, name in enumerate(ways)}}
    return {name: found for name, number in names.items() if bool((found := strongest == number).any())}


def label(regions: Mapping[str, Tensor], vertices: int) -> list[str]:
    """The name of each vertex's region; empty where it has none."""
    labels = [""] * vertices
    for name, members in regions.items():
        for vertex in members.nonzero()[:, 0].tolist():
            labels[vertex] = name
    return labels


def vertex_weights(
    rig: RigBackend, weights: Mapping[str, Any] | None, own: Mapping[str, str] | None, default: float
) -> Tensor | None:
    """How much each vertex counts, `(vertex,)`; None where all count alike.

    Args:
        weights: region or glob of regions to weight; later ones overrule earlier ones.
        own: further regions: name to a file of vertex numbers (.txt, .json, .npy), or of all vertices' weights (.npy).
        default: of vertices that no name takes in.

    Raises:
        InputError: a name fits no region, a weight is none, a file is wrong, or no vertex is left.
    """
    _check_weight("vertices.default", default)
    weights, own = _mapping("vertices.weights", weights), _mapping("vertices.regions", own)
    regions = {name: members.float() for name, members in regions_of(rig).items()}
    regions |= {name: read_region(Path(path), len(rig.rest_vertices)) for name, path in own.items()}
    if not weights and default == 1:
        return None
    result = torch.full((len(rig.rest_vertices),), float(default))
    for glob, weight in weights.items():
        _check_weight(f"vertices.weights.{glob}", weight)
        names = [name for name in regions if fnmatchcase(name, glob)]
        if not names:
            known = ", ".join(list(regions)[:40]) or "none; name files of vertex numbers with vertices.regions"
            raise InputError(f"vertices.weights names {glob!r}, and rig '{rig.name}' has no such region; it has: {known}")
        for name in names:
            result += regions[name] * (weight - result)
    if not bool((result > 0).sum() >= 3):
        raise InputError("vertices.weights leaves fewer than three vertices with a weight above 0: there is nothing to fit")
    return None if bool((result == 1).all()) else result / result.max()


def _mapping(key: str, value: Any) -> Mapping[str, Any]:
    if value is not None and not isinstance(value, Mapping):
        raise InputError(f"{key} is {value!r}, expected names, each with a value: {key}={{mouth: 2}}")
    return {str(name): given for name, given in (value or {}).items()}


def _check_weight(key: str, weight: Any) -> None:
    if not isinstance(weight, int | float) or isinstance(weight, bool) or not 0 <= weight <= 1e6:
        raise InputError(f"{key} is {weight!r}, expected a weight of at least 0")


def read_region(path: Path, vertices: int) -> Tensor:
    """A region from a file: how much of each vertex belongs, `(vertex,)` in [0, 1].

    Raises:
        InputError: the file is missing or holds something else than vertex numbers or weights of all vertices.
    """
    expected = f"expected vertex numbers from 0 to {vertices - 1}, or a float in [0, 1] for each of {vertices} vertices (.npy)"
    try:
        if path.suffix == ".npy":
            check_npy(path)
            values = np.load(path, allow_pickle=False)
        else:
            text = path.read_text(encoding="utf-8")
            values = np.array(json.loads(text) if path.suffix == ".json" else _numbers(text))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file, asked for by vertices.regions") from None
    except (OSError, ValueError, EOFError, RecursionError) as error:
        raise InputError(f"{path}: {expected}; it cannot be read: {str(error)[:120]}") from None
    if values.dtype.kind == "f" and values.shape == (vertices,) and values.min() >= 0 and values.max() <= 1:
        return torch.tensor(values, dtype=torch.float32)
    if values.dtype.kind not in "iu" or values.ndim != 1 or not values.size or values.min() < 0 or values.max() >= vertices:
        raise InputError(f"{path}: {expected}; found {values.dtype} of shape {values.shape}")
    result = torch.zeros(vertices)
    result[torch.tensor(values.astype(np.int64))] = 1.0
    return result


def _numbers(text: str) -> Sequence[int]:
    return [int(word) for word in text.replace(",", " ").split()]


def weighted_space(rig: LinearRig, weights: Tensor) -> MeshSpace:
    """The mesh space of a rig whose vertices count by `weights` `(vertex,)`.

    Its frame is Q^T W^(1/2): good for encoding, and for the rig's linear map; its rows are not orthonormal, so that decoding
    with it means nothing.
    """
    roots = weights.double().sqrt()[:, None]
    rows = (rig.basis.double() * roots).flatten(1)
    squares, vectors = torch.linalg.eigh(rows @ rows.T)
    values = squares.clamp_min(0).sqrt()
    kept = (values > RANK_TOLERANCE**0.5 * values.amax()).nonzero()[:, 0].flip(0)
    frame = (vectors[:, kept] / values[kept]).T @ rows
    frame = torch.linalg.qr(frame.T)[0].T  # once more: the Gram matrix has squared the faint ones' rounding errors
    return MeshSpace(rig.rest_vertices, (frame.unflatten(1, rig.rest_vertices.shape) * roots).to(rig.dtype))
