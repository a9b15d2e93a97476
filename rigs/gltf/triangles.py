"""Triangles of a primitive from its indices and mode."""

import numpy as np

from riginv.errors import InputError
from rigs.gltf.accessors import MOST_NUMBERS, count_of, read_indices
from rigs.gltf.container import GltfFile

MODES = ("POINTS", "LINES", "LINE_LOOP", "LINE_STRIP", "TRIANGLES", "TRIANGLE_STRIP", "TRIANGLE_FAN")
TRIANGLES, STRIP, FAN = 4, 5, 6


def read_triangles(file: GltfFile, primitive: dict, vertices: int, user: str) -> np.ndarray:
    """Triangles of a primitive, without degenerate ones.

    Args:
        primitive: of the document.
        vertices: number of its vertices.
        user: its label for messages.

    Returns:
        `(face, 3)` int64 vertex indices.

    Raises:
        InputError: points or lines, an index out of range, or incomplete triangles.
    """
    mode = primitive.get("mode", TRIANGLES)
    if mode not in (TRIANGLES, STRIP, FAN):
        found = MODES[mode] if mode < len(MODES) else mode
        raise InputError(f"{file.path}: {user} is made of {found}, expected triangles: leave it out with rig.exclude=[NAME]")
    if "indices" in primitive:
        if count_of(file, primitive["indices"], f"indices of {user}") > MOST_NUMBERS // 3:
            raise InputError(f"{file.path}: {user} has too many indices to be meant: the file is damaged; export it again")
        indices = read_indices(file, primitive["indices"], "SCALAR", f"indices of {user}")[:, 0]
        if indices.max() >= vertices:
            raise InputError(
                f"{file.path}: accessors[{primitive['indices']}], indices of {user}, uses vertex {indices.max()}, it has "
                f"vertices 0 to {vertices - 1}: the file is damaged; export it again"
            )
    else:
        indices = np.arange(vertices)
    if (mode == TRIANGLES and len(indices) % 3) or len(indices) < 3:
        raise InputError(f"{file.path}: {user} has {len(indices)} corners, which make no whole triangles: export it again")
    faces = _faces(indices, mode)
    return faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]


def _faces(indices: np.ndarray, mode: int) -> np.ndarray:
    if mode == TRIANGLES:
        return indices.reshape(-1, 3)
    if mode == FAN:
        return np.stack([indices[1:-1], indices[2:], np.broadcast_to(indices[0], len(indices) - 2)], axis=1)
    faces = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    faces[1::2] = faces[1::2, [0, 2, 1]]  # alternate triangles of a strip have the opposite winding
    return faces
