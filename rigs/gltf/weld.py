"""Welding: vertices that exporters split at seams of texture or shading become one again."""

import hashlib

import numpy as np

from rigs.gltf.container import GltfFile
from rigs.gltf.pieces import Piece
from rigs.gltf.scene import Scene


def weld_map(file: GltfFile, scene: Scene, pieces: list[Piece]) -> np.ndarray:
    """Which vertices are one: those of one node with equal positions, equal deltas of every target and equal skin weights.

    Returns:
        `(file vertex,)` int64: the number of the welded vertex that each became; welded vertices keep their order.
    """
    seen: dict[bytes, int] = {}
    numbers = []
    for piece in pieces:
        parts = [piece.positions(file), *(change for _, change in piece.deltas(file))]
        if "skin" in file.document["nodes"][piece.node]:
            parts.append(piece.carriers(file, scene).shares)
        moved_by = [name for name, accessor in piece.targets.items() if accessor is not None]
        start = f"{piece.node} {moved_by} ".encode()
        rows = np.concatenate(parts, axis=1).astype(np.float32) + 0.0  # -0 and 0 are one place
        for row in rows:
            key = hashlib.blake2b(start + row.tobytes(), digest_size=20).digest()
            numbers.append(seen.setdefault(key, len(seen)))
    return np.array(numbers, dtype=np.int64)
