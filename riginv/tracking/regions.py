"""Named regions of a rig's mesh: to weight vertices, and to locate a frame's largest error."""

import json
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from riginv.errors import InputError, listed
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import RANK_TOLERANCE, MeshSpace
from riginv.runs.array_files import load_numbers, whole_numbers
from riginv.tracking.options import VertexOptions

STEMS = ("brow", "eye", "cheek", "nose", "mouth", "jaw", "tongue")  # of the names of ARKit's shapes
STILL = "still"  # the region that no shape moves
MIN_MOVEMENT = 0.02  # of the largest displacement by a region's shapes: vertices that move less are not in it


def regions_of(rig: RigBackend) -> dict[str, Tensor]:
    """The disjoint regions of a rig: masks `(vertex,)` by name.

    The regions of a skeleton are its joints. The regions of a face are named by the ARKit shapes that move a vertex most, or
    `still`. Empty for other rigs.
    """
    skeleton = rig.skeleton()
    if skeleton is not None:
        strongest = skeleton.weights.argmax(dim=1)
        return {name: found for number, name in enumerate(skeleton.joint_names) if bool((found := strongest == number).any())}
    shapes = rig.arkit_deltas()
    moved = {stem: [delta.norm(dim=1) for name, delta in shapes.items() if name.startswith(stem)] for stem in STEMS}
    largest = {stem: torch.stack(found).amax(dim=0) for stem, found in moved.items() if found}
    if not largest:
        return {}
    fractions = torch.stack([distance / distance.max().clamp_min(1e-9) for distance in largest.values()])
    strongest = torch.where(fractions.amax(dim=0) > MIN_MOVEMENT, fractions.argmax(dim=0), -1)
    names = {STILL: -1, **{name: number for number, name in enumerate(largest)}}
    return {name: found for name, number in names.items() if bool((found := strongest == number).any())}


def label(regions: Mapping[str, Tensor], vertices: int) -> list[str]:
    """The region name of each vertex; empty where it is in none."""
    labels = [""] * vertices
    for name, members in regions.items():
        for vertex in members.nonzero()[:, 0].tolist():
            labels[vertex] = name
    return labels


def vertex_weights(rig: RigBackend, options: VertexOptions) -> Tensor | None:
    """The weight of each vertex, `(vertex,)`; None where all are equal.

    Raises:
        InputError: a name matches no region, a file is wrong, or fewer than three vertices count.
    """
    weights = options.weights or {}
    regions = {name: members.float() for name, members in regions_of(rig).items()}
    regions |= {name: read_region(Path(path), len(rig.rest_vertices)) for name, path in (options.regions or {}).items()}
    if not weights and options.default == 1:
        return None
    result = torch.full((len(rig.rest_vertices),), float(options.default))
    for glob, weight in weights.items():
        names = [name for name in regions if fnmatchcase(name, glob)]
        if not names:
            known = listed(regions, 40) if regions else "none; name files of vertex numbers with vertices.regions"
            raise InputError(f"vertices.weights names {glob!r}, and rig '{rig.name}' has no such region; it has: {known}")
        for name in names:
            result += regions[name] * (weight - result)
    if not bool((result > 0).sum() >= 3):
        raise InputError("vertices.weights leaves fewer than three vertices with a weight above 0: there is nothing to fit")
    return None if bool((result == 1).all()) else result / result.max()


def read_region(path: Path, vertices: int) -> Tensor:
    """A region from a file: the membership of each vertex, `(vertex,)` in [0, 1].

    Raises:
        InputError: the file is missing, or holds neither vertex indices nor weights of all vertices.
    """
    expected = f"expected vertex numbers from 0 to {vertices - 1}, or a float in [0, 1] for each of {vertices} vertices (.npy)"
    values = load_numbers(path, "vertices.regions", expected, json.loads if path.suffix == ".json" else whole_numbers)
    if values.dtype.kind == "f" and values.shape == (vertices,) and values.min() >= 0 and values.max() <= 1:
        return torch.tensor(values, dtype=torch.float32)
    if values.dtype.kind not in "iu" or values.ndim != 1 or not values.size or values.min() < 0 or values.max() >= vertices:
        raise InputError(f"{path}: {expected}; found {values.dtype} of shape {values.shape}")
    result = torch.zeros(vertices)
    result[torch.tensor(values.astype(np.int64))] = 1.0
    return result


def weighted_space(rig: LinearRig, weights: Tensor) -> MeshSpace:
    """The mesh space of a rig with vertex weights `(vertex,)`.

    Its frame is Q^T W^(1/2): valid for encoding and for the rig's linear map, not for decoding, as its rows are not
    orthonormal.
    """
    roots = weights.double().sqrt()[:, None]
    rows = (rig.basis.double() * roots).flatten(1)
    squares, vectors = torch.linalg.eigh(rows @ rows.T)
    values = squares.clamp_min(0).sqrt()
    kept = (values > RANK_TOLERANCE**0.5 * values.amax()).nonzero()[:, 0].flip(0)
    frame = (vectors[:, kept] / values[kept]).T @ rows
    frame = torch.linalg.qr(frame.T)[0].T  # the Gram matrix has squared rounding errors
    return MeshSpace(rig.rest_vertices, (frame.unflatten(1, rig.rest_vertices.shape) * roots).to(rig.dtype))
