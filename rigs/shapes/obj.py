"""Wavefront OBJ: the `v` and `f` lines, as they stand."""

import re
from pathlib import Path

import numpy as np

from riginv.errors import InputError

LINE = re.compile(r"^[ \t]*([vf])[ \t]+([^\n]*)", re.MULTILINE)


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices `(vertex, 3)`, the size of each face `(face,)`, and the vertex of each corner `(corner,)`, from 0.

    Texture coordinates and normals have an order of their own in an OBJ; the vertices stay whole along seams.

    Raises:
        InputError: a line that is no vertex or no face; the message names it.
    """
    text = path.read_text(encoding="latin-1")  # any byte will do in a comment or a material's name
    text = re.sub(r"\\\r?\n", " ", text)  # a line that goes on in the next
    vertices: list[list[float]] = []
    sizes: list[int] = []
    corners: list[int] = []
    for line in LINE.finditer(text):
        words = line[2].partition("#")[0].split()
        try:
            if line[1] == "v":
                vertices.append([float(words[0]), float(words[1]), float(words[2])])
                continue
            for word in words:
                index = int(word.partition("/")[0])
                corners.append(index - 1 if index >= 0 else len(vertices) + index)  # -1: the vertex just above
            sizes.append(len(words))
        except (ValueError, IndexError):
            number = text.count("\n", 0, line.start()) + 1
            expected = "v X Y Z" if line[1] == "v" else "f and the numbers of its corners"
            found = line[0].strip()[:60]
            raise InputError(
                f"{path}, line {number}: found '{found}', expected {expected}: truncated? export it again"
            ) from None
    try:
        return np.array(vertices).reshape(-1, 3), np.array(sizes, dtype=np.int64), np.array(corners, dtype=np.int64)
    except OverflowError:
        raise InputError(f"{path}: a face uses vertex {max(map(abs, corners)) + 1}: damaged; export it again") from None
