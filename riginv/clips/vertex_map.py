"""Clips of a larger mesh, or of the rig's mesh in another vertex order, mapped to the rig's vertices."""

from pathlib import Path

import numpy as np

from riginv.clips.sequence import MeshSequence
from riginv.errors import InputError
from riginv.runs.array_files import load_numbers, whole_numbers

UNKNOWN = -1


class MappedVertices(MeshSequence):
    """The vertices of another sequence in the rig's order.

    Args:
        sequence: the other sequence.
        path: file (.npy or text) with the index of the clip's vertex for each vertex of the rig; -1 where it has none.

    Raises:
        InputError: the file holds anything else.
    """

    def __init__(self, sequence: MeshSequence, path: Path) -> None:
        self.sequence = sequence
        self.vertex_map = read_vertex_map(path, sequence.vertex_count)
        known = sequence.fps, sequence.unit_mm, sequence.up, sequence.facts
        super().__init__(sequence.path, sequence.frame_numbers, len(self.vertex_map), None, *known)

    def read(self, start: int, stop: int) -> np.ndarray:
        values = self.sequence.read(start, stop)[:, self.vertex_map]
        values[:, self.vertex_map == UNKNOWN] = np.nan
        return values


def read_vertex_map(path: Path, vertices: int) -> np.ndarray:
    """Indices `(rig vertex,)` of a clip's vertices."""
    expected = f"expected for each vertex of the rig a number from 0 to {vertices - 1}, or -1"
    found = load_numbers(path, "reading.vertices", expected, whole_numbers)
    if found.dtype.kind not in "iu" or found.ndim != 1 or not found.size or found.min() < -1 or found.max() >= vertices:
        raise InputError(f"{path}: {expected}; found {found.dtype} of shape {found.shape}")
    return found.astype(np.int64)
