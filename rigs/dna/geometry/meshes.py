"""Meshes of a file: selection, vertices, triangles, skin weights and targets."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from scipy import sparse

from riginv.errors import InputError
from rigs.dna.format import DnaFile
from rigs.dna.format.layers import Definition, Geometry, Mesh
from rigs.dna.geometry.skeleton import stacked
from rigs.dna.geometry.space import Space
from rigs.dna.logic.layout import Layout

LOG = logging.getLogger(__name__)
SUM_TOLERANCE = 1e-3  # deviation of the sum of skin weights from 1 that is not reported


@dataclass(frozen=True)
class Surface:
    """Concatenated meshes, mm along riginv's axes.

    Attributes:
        names: of the meshes.
        starts: the first vertex of each mesh, and one past the last of all, `(mesh + 1,)`.
        rest: `(vertex, 3)` float64.
        triangles: `(face, 3)`.
        weights: skin weights `(vertex, joint + 1)`; the last column is of unskinned vertices.
        deltas: `(3 vertex, channel)`, per coordinate.
    """

    names: tuple[str, ...]
    starts: np.ndarray
    rest: np.ndarray
    triangles: np.ndarray
    weights: sparse.csr_array
    deltas: sparse.csr_array


def chosen_meshes(file: DnaFile, layout: Layout, lod: int, globs: Sequence[str]) -> list[int]:
    """Indices of the meshes of a level of detail that match globs; all without globs.

    Raises:
        InputError: no mesh matches.
    """
    definition, geometry = file.need(Definition), file.need(Geometry)
    if len(geometry.meshes) != len(definition.meshes):
        raise layout.wrong(f"{len(definition.meshes)} meshes have names, {len(geometry.meshes)} have vertices")
    names = definition.meshes
    numbers = layout.rows_of_lod("the meshes", definition.lod_meshes, lod, len(names), "meshes").tolist()
    if not numbers:
        raise InputError(
            f"{file.path}: level of detail {lod} has no meshes; rig.lod takes 0 to {max(layout.lod_count - 1, 0)}, and the "
            f"file has {len(names)} meshes"
        )
    there = ", ".join(names[number] for number in numbers)[:300]
    for glob in globs:
        if not any(fnmatchcase(names[number], glob) for number in numbers):
            raise InputError(
                f"{file.path}: rig.meshes names {glob!r}, no mesh of level of detail {lod} is called so; they are: {there}"
            )
    return [number for number in numbers if not globs or any(fnmatchcase(names[number], glob) for glob in globs)]


def read_surface(file: DnaFile, layout: Layout, space: Space, numbers: Sequence[int]) -> Surface:
    """Meshes of a file.

    Raises:
        InputError: a mesh is damaged, or too large or too small for the unit that the file states.
    """
    definition, geometry = file.need(Definition), file.need(Geometry)
    joints, channels = len(definition.joints), len(definition.channels)
    rests, triangles, weights, deltas, starts = [], [], [], [], [0]
    for number in numbers:
        mesh, what = geometry.meshes[number], f"mesh '{definition.meshes[number][:60]}'"
        rest = space.vectors(stacked(mesh.positions, layout, f"the positions of {what}"))
        triangles.append(starts[-1] + _triangles(layout, what, mesh, len(rest), space.flips_faces))
        weights.append(_weights(layout, what, mesh, len(rest), joints))
        deltas.append(_deltas(layout, what, mesh, len(rest), channels, space))
        rests.append(rest)
        starts.append(starts[-1] + len(rest))
    surface = Surface(
        names=tuple(definition.meshes[number] for number in numbers),
        starts=np.array(starts),
        rest=np.concatenate(rests),
        triangles=np.concatenate(triangles),
        weights=sparse.csr_array(sparse.vstack(weights)),
        deltas=sparse.csr_array(sparse.vstack(deltas)),
    )
    if not len(surface.rest):
        raise InputError(
            f"{file.path}: the meshes {', '.join(surface.names)[:200]} have no vertices: choose others by rig.meshes"
        )
    space.check_size(file, surface.rest)
    return surface


def _triangles(layout: Layout, what: str, mesh: Mesh, vertices: int, flip: bool) -> np.ndarray:
    """Faces as triangle fans, `(triangle, 3)`."""
    corners, sizes = mesh.faces
    layout.check(f"a face of {what}", corners, len(mesh.position_of_corner), "corners")
    layout.check(f"a corner of {what}", mesh.position_of_corner, vertices, "vertices")
    if (sizes < 3).any():
        number = int(np.argmax(sizes < 3))
        raise layout.wrong(f"face {number} of {what} has {int(sizes[number])} corners, expected at least 3")
    of_corner = mesh.position_of_corner.astype(np.int64)[corners]
    counts = sizes - 2
    first = np.repeat(np.cumsum(sizes) - sizes, counts)
    step = 1 + np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    fan = of_corner[np.stack([first, first + step, first + step + 1], axis=1)] if len(first) else np.zeros((0, 3), np.int64)
    return fan[:, ::-1] if flip else fan


def _weights(layout: Layout, what: str, mesh: Mesh, vertices: int, joints: int) -> sparse.csr_array:
    """Skin weights `(vertex, joint + 1)`, each row summing to 1."""
    values, carriers = mesh.influences
    if not len(values.values):
        unskinned = np.zeros(vertices), (np.arange(vertices), np.full(vertices, joints))
        return sparse.csr_array((1 + unskinned[0], unskinned[1]), shape=(vertices, joints + 1))
    name = f"the skin weights of {what}"
    if len(values.sizes) != vertices:
        raise layout.wrong(f"{name}: {len(values.sizes)} rows for {vertices} vertices")
    if not np.array_equal(values.sizes, carriers.sizes):
        vertex = int(np.argmax(values.sizes != carriers.sizes))
        raise layout.wrong(f"{name}: vertex {vertex} has {values.sizes[vertex]} weights for {carriers.sizes[vertex]} joints")
    layout.check(name, carriers.values, joints, "joints")
    layout.check_finite(name, values.values)
    owners = values.owners
    if (values.values < 0).any():
        vertex = int(owners[np.argmax(values.values < 0)])
        raise layout.wrong(f"{name}: vertex {vertex} has a negative weight")
    sums = np.bincount(owners, values.values.astype(np.float64), minlength=vertices)
    if not (sums > 0).all():
        raise layout.wrong(f"{name}: vertex {int(np.argmin(sums))} has no weight above 0")
    off = np.abs(sums - 1)
    if (off > SUM_TOLERANCE).any():
        LOG.info(
            f"{layout.where}: {name} of {int((off > SUM_TOLERANCE).sum())} vertices do not sum to 1, such as "
            f"{sums[np.argmax(off)]:.4g} of vertex {int(np.argmax(off))}: they were divided by their sums"
        )
    positions = owners, carriers.values.astype(np.int64)
    return sparse.csr_array((values.values / sums[owners], positions), shape=(vertices, joints + 1))


def _deltas(layout: Layout, what: str, mesh: Mesh, vertices: int, channels: int, space: Space) -> sparse.csr_array:
    """The deltas `(3 vertex, channel)` of all targets."""
    rows, columns, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
    for number, target in enumerate(mesh.targets):
        name = f"target {number} of {what}"
        deltas = space.vectors(stacked(target.deltas, layout, name, len(target.vertices)))
        layout.check(name, target.vertices, vertices, "vertices")
        layout.check(name, np.array([target.channel]), channels, "channels")
        rows.append((3 * target.vertices.astype(np.int64)[:, None] + np.arange(3)).reshape(-1))
        columns.append(np.full(deltas.size, target.channel, np.int64))
        values.append(deltas.reshape(-1))
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_array(entries, shape=(3 * vertices, channels))
