"""Rest mesh and basis from the files of a folder, cached until a file or a setting changes."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from scipy import sparse
from torch import Tensor

import riginv.meshes
from riginv.errors import InputError
from riginv.meshes.reading import READERS
from riginv.runs.cache import cached_tensors, code_key
from rigs.shapes.deltas import read_deltas
from rigs.shapes.folder import Source
from rigs.shapes.logic import ShapeLogic
from rigs.shapes.mesh import Sculpt, read_sculpt
from rigs.shapes.names import Convention


def shape_geometry(
    neutral: Path, sources: Mapping[str, Source], shapes: Convention, logic: ShapeLogic, unit_mm: float
) -> dict[str, Tensor]:
    """Tensors of a folder of shapes.

    Returns:
        rest_vertices `(vertex, 3)` and basis `(shape, vertex, 3)`, mm, in the order of `shapes.names`; faces `(face, 3)`;
        notes `(byte,)`: sentences for the user, one per line, UTF-8.

    Raises:
        InputError: a file cannot be read, or does not match the neutral.
    """
    files = [neutral, *sorted({source.path for source in sources.values()})]
    facts = {
        "code": code_key([Path(__file__).parent, Path(riginv.meshes.__file__).parent]),
        "files": [(str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns) for path in files],
        "deltas": [sources[name].is_deltas for name in shapes.names],
        "shapes": [shapes.names, shapes.inbetweens, shapes.combinations, shapes.combination_inbetweens],
        "settings": [str(neutral), unit_mm, logic.combine.__name__],
    }
    key = hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16]
    return cached_tensors("shapes", key, lambda: build_geometry(neutral, sources, shapes, logic, unit_mm))


def build_geometry(
    neutral_path: Path, sources: Mapping[str, Source], shapes: Convention, logic: ShapeLogic, unit_mm: float
) -> dict[str, Tensor]:
    """Build what `shape_geometry` returns, without the cache."""
    neutral = read_sculpt(neutral_path)
    if not len(neutral.faces):
        raise InputError(f"{neutral_path}: the neutral has vertices but no faces; export it again with its faces")
    notes = list(neutral.notes)
    console = Console(stderr=True)
    names = track(shapes.names, "reading shapes", console=console, transient=True, disable=not console.is_terminal)
    found = np.stack([_read(name, sources[name], neutral, notes) for name in names]).astype(np.float32)
    return {
        "rest_vertices": torch.tensor(neutral.vertices * unit_mm, dtype=torch.float32),
        "faces": torch.tensor(neutral.faces.fans()),
        "basis": torch.from_numpy(solve_basis(found, sources, shapes, logic) * np.float32(unit_mm)),
        "notes": torch.tensor(list("\n".join(dict.fromkeys(notes)).encode()), dtype=torch.uint8),
    }


def notes_of(geometry: Mapping[str, Tensor]) -> tuple[str, ...]:
    """Notes for the user from the tensors of `shape_geometry`."""
    return tuple(filter(None, bytes(geometry["notes"].tolist()).decode().split("\n")))


def _read(name: str, source: Source, neutral: Sculpt, notes: list[str]) -> np.ndarray:
    """Displacement of each vertex of the neutral, `(vertex, 3)`, in the file's unit."""
    if source.path.suffix.lower() not in READERS:
        return read_deltas(source.path, name, len(neutral.vertices)).astype(np.float32)
    mesh = read_sculpt(source.path, neutral)
    mesh.check_like(neutral)
    notes.extend(mesh.file.notes)
    return (mesh.vertices if source.is_deltas else mesh.vertices - neutral.vertices).astype(np.float32)


def solve_basis(found: np.ndarray, sources: Mapping[str, Source], shapes: Convention, logic: ShapeLogic) -> np.ndarray:
    """Deltas `(shape, vertex, 3)` with which the rig reproduces each sculpt exactly in its pose.

    With the weights of all shapes in the pose of each sculpt as the rows of a matrix, weights @ deltas = sculpts - neutral: the
    deltas of a combination are its sculpt minus the sum of its parts. Files with deltas are taken as they are.

    Args:
        found: `(shape, vertex, 3)`: sculpt less neutral, or deltas.
    """
    primary = {name: number for number, name in enumerate(shapes.primaries)}
    poses = torch.zeros(len(shapes.names), len(primary), dtype=torch.float64)
    for row, name in enumerate(shapes.names):
        for shape, weight in shapes.pose(name).items():
            poses[row, primary[shape]] = weight
    weights = logic(poses).numpy()
    given = np.array([sources[name].is_deltas for name in shapes.names])
    weights[given] = np.eye(len(weights))[given]
    inverse = np.linalg.inv(weights)[len(primary) :]  # primary shapes are their own deltas
    inverse[np.abs(inverse) < 1e-12] = 0
    solved = sparse.csr_array(inverse) @ found.reshape(len(found), -1)
    return np.concatenate([found[: len(primary)], solved.reshape(-1, *found.shape[1:]).astype(np.float32)])
