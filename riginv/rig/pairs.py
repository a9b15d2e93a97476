"""Tables of sampled pairs: controls and a rig's vertices at these, written by the program in which the rig runs.

A table is a `.npz` file, a folder of `.npy` files, or a zarr group, with these arrays:

controls       (pose, control)
vertices       (pose, vertex, 3), mm
rest_vertices  (vertex, 3), mm: the mesh at the neutral controls
faces          (face, 3): indices of vertices
control_names  (control,) text
lower, upper, neutral  (control,)
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import zarr
from torch import Tensor

from riginv.errors import InputError, in_short
from riginv.rig.interface import Control
from riginv.runs.array_files import BROKEN, DAMAGED_ZIP, check_npy, check_npz, check_zarr
from riginv.runs.files import atomic_write

SHAPES = {
    "controls": ("pose", "control"),
    "vertices": ("pose", "vertex", 3),
    "rest_vertices": ("vertex", 3),
    "faces": ("face", 3),
    "control_names": ("control",),
    "lower": ("control",),
    "upper": ("control",),
    "neutral": ("control",),
}

NOT_READ = (OSError, AttributeError, *BROKEN, *DAMAGED_ZIP)  # that libraries raise for damaged files


@dataclass(frozen=True)
class PairTable:
    """A table of pairs, checked.

    Attributes:
        controls: `(pose, control)`.
        vertices: `(pose, vertex, 3)`, mm.
        rest_vertices: `(vertex, 3)`, mm.
        faces: `(face, 3)`.
        described: the controls.
    """

    controls: Tensor
    vertices: Tensor
    rest_vertices: Tensor
    faces: Tensor
    described: list[Control]


def read_pairs(path: str | Path) -> PairTable:
    """Read a table of pairs.

    Raises:
        InputError: there is none, an array is missing, of the wrong shape or type, or holds NaN or infinite values.
    """
    arrays = _open(Path(path))
    for name in SHAPES:
        if name not in arrays:
            raise InputError(
                f"{path}: no array '{name}'; a table of pairs holds {', '.join(SHAPES)}, this holds {_list(arrays)}"
            )
    try:
        read = {name: np.asarray(arrays[name]) for name in SHAPES}
    except NOT_READ as error:
        raise InputError(f"{path}: cannot be read: {in_short(error)}; sample it again") from None
    _check(path, read)
    names = [str(name) for name in read["control_names"]]
    limits = zip(names, *(read[field].tolist() for field in ("lower", "upper", "neutral")))
    controls = [Control(name, lower, upper, neutral) for name, lower, upper, neutral in limits]
    numbers = (torch.tensor(read[name], dtype=torch.float32) for name in ("controls", "vertices", "rest_vertices"))
    poses, vertices, rest = numbers
    return PairTable(poses, vertices, rest, torch.tensor(read["faces"].astype(np.int64)), controls)


def write_pairs(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write a table of pairs, atomically: a zarr group where the name ends in `.zarr`, else `.npz`.

    Raises:
        InputError: the arrays are not those of such a table.
    """
    path = Path(path)
    _check(path, arrays)
    with atomic_write(path) as beside:
        if path.suffix == ".zarr":
            group = zarr.open_group(beside, mode="w", zarr_format=2)  # format 3 has no stable text yet
            for name in SHAPES:
                group.create_array(name, data=np.asarray(arrays[name]))
        else:
            with beside.open("wb") as file:
                np.savez(file, allow_pickle=False, **{name: np.asarray(arrays[name]) for name in SHAPES})


def _open(path: Path) -> Mapping[str, Any]:
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; give a table of pairs: .npz, a folder of .npy files, or .zarr")
    try:
        if path.is_file():
            (check_npy if path.suffix == ".npy" else check_npz)(path)
            opened = np.load(path, allow_pickle=False)
            if isinstance(opened, np.lib.npyio.NpzFile):
                return opened
        elif list(path.glob("*.npy")):
            files = sorted(path.glob("*.npy"))
            for file in files:
                check_npy(file)
            return {file.stem: np.load(file, mmap_mode="r", allow_pickle=False) for file in files}
        else:
            group = zarr.open_group(path, mode="r")
            arrays = {name: group[name] for name in group.array_keys()}
            check_zarr(path, arrays)
            return arrays
    except InputError:
        raise
    except NOT_READ as error:
        raise InputError(f"{path}: no table of pairs: {in_short(error)}; sample it again") from None
    raise InputError(f"{path}: one array alone is no table of pairs: name the folder of .npy files, or a .npz")


def _check(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    sizes: dict[str, tuple[int, str]] = {}
    for name, expected in SHAPES.items():
        shape = np.shape(arrays[name])
        if len(shape) != len(expected):
            raise InputError(f"{path}: '{name}' has shape {shape}, expected ({', '.join(map(str, expected))})")
        for size, word in zip(shape, expected):
            known, by = sizes.setdefault(str(word), (size if isinstance(word, str) else word, name))
            if size != known:
                meant = f"{known} {word}s as in '{by}'" if isinstance(word, str) else str(known)
                raise InputError(f"{path}: '{name}' has shape {shape}, expected {meant} where it has {size}")
        kind = np.asarray(arrays[name][:0]).dtype.kind
        if kind not in {"control_names": "UST", "faces": "iu"}.get(name, "fiu"):
            raise InputError(f"{path}: '{name}' holds {np.asarray(arrays[name][:0]).dtype}, expected {_kind(name)}")
        if kind == "f" and not np.isfinite(arrays[name]).all():
            raise InputError(f"{path}: '{name}' holds NaN or infinite values; sample it again without them")
    for word in ("pose", "control", "vertex"):
        if not sizes[word][0]:
            raise InputError(f"{path}: '{sizes[word][1]}' holds no {word}s")


def _kind(name: str) -> str:
    return {"control_names": "text", "faces": "whole numbers"}.get(name, "numbers")


def _list(arrays: Mapping[str, Any]) -> str:
    return ", ".join(sorted(arrays)) or "nothing"
