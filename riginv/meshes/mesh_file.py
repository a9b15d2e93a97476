"""The interface of mesh files.

General loaders merge, split and reorder vertices, and a mesh whose vertex order differs from its rig's is useless. The readers
here keep the file's vertices and faces in its order.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.errors import listed
from riginv.meshes.polygons import Polygons


class MeshFile(ABC):
    """A mesh in a file.

    Attributes:
        path: of the file.
        points: `(vertex, 3)` float64, in the file's unit and order; NaN or infinite where a coordinate is unknown.
        face_bytes: the part of the file with its faces: files with equal bytes have equal faces.
        notes: sentences about what was repaired.
        unit_mm: millimetres per unit; None where the format does not say it.
        up: the up axis, `x`, `y` or `z`; None where the format does not say it.
    """

    unit_mm: float | None = None
    up: str | None = None

    def __init__(self, path: Path, points: np.ndarray, face_bytes: bytes, notes: tuple[str, ...] = ()) -> None:
        self.path, self.points, self.face_bytes, self.notes = path, points, face_bytes, notes

    @property
    def objects(self) -> tuple[str, ...]:
        """The names of the objects in the file, where it names any."""
        return ()

    def vertices_of(self, name: str) -> np.ndarray:
        """The vertices `(vertex,)` of an object, ascending."""
        raise KeyError(name)

    @abstractmethod
    def polygons(self) -> Polygons | None:
        """The faces; None where there are none.

        Raises:
            InputError: they are truncated or damaged.
        """


def note_on_objects(path: Path, names: Sequence[str]) -> tuple[str, ...]:
    """The note that several objects of a file are read as one mesh."""
    if len(names) < 2:
        return ()
    return (f"{len(names)} objects in {path.name} ({listed(names)}) were read as one mesh, in this order.",)


class Points(NamedTuple):
    """Vertices `(vertex, 3)` float64, and sentences about what was repaired to read them."""

    values: np.ndarray
    notes: tuple[str, ...] = ()
