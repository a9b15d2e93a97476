"""Folders of shapes for tests: a small mesh with faces of every kind, and writers of the files that hold it."""

import struct
from pathlib import Path

import numpy as np

# A pentagon, two quads and a triangle around eight points: faces of every kind.
POINTS = np.array([[0, 0, 0], [2, 0, 0], [3, 1, 0], [2, 2, 0], [0, 2, 0], [0, 0, 1], [2, 0, 1], [1, 3, 0]], dtype=float)
FACES = [[0, 1, 2, 3, 4], [0, 5, 6, 1], [0, 4, 7, 5], [3, 7, 4]]
FAN = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 5, 6], [0, 6, 1], [0, 4, 7], [0, 7, 5], [3, 7, 4]]


def offset(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=POINTS.shape).round(6)


def write_obj(path: Path, points: np.ndarray, faces=FACES, corner="{0}") -> None:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    lines += ["f " + " ".join(corner.format(index + 1) for index in face) for face in faces]
    path.write_text("\n".join(lines) + "\n")


def write_ply(path: Path, points: np.ndarray, kind: str) -> None:
    """A PLY with a colour for each vertex, and faces whose lists come after another property."""
    header = (
        f"ply\nformat {kind} 1.0\ncomment made by a test\nelement vertex {len(points)}\nproperty double x\nproperty double y\n"
    )
    header += f"property double z\nproperty uchar red\nelement face {len(FACES)}\nproperty short group\n"
    header += "property list uchar int vertex_indices\nelement edge 1\nproperty int one\nend_header\n"
    if kind == "ascii":
        body = "".join(f"{x!r} {y!r} {z!r} 7\n" for x, y, z in points.tolist())
        body += "".join(f"3 {len(face)} {' '.join(map(str, face))}\n" for face in FACES) + "9\n"
        return path.write_text(header + body)
    order = "<" if "little" in kind else ">"
    rows = [struct.pack(order + "dddB", *point, 7) for point in points]
    rows += [struct.pack(f"{order}hB{len(face)}i", 3, len(face), *face) for face in FACES]
    path.write_bytes(header.encode() + b"".join(rows) + struct.pack(order + "i", 9))


def write_folder(folder: Path, **shapes: np.ndarray) -> Path:
    folder.mkdir(exist_ok=True)
    write_obj(folder / "neutral.obj", POINTS)
    for name, points in shapes.items():
        write_obj(folder / f"{name}.obj", points)
    return folder
