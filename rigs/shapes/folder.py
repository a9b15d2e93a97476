"""Listing of a folder of shapes: names and sources. Only headers are read here."""

import difflib
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from riginv.errors import InputError, listed
from riginv.meshes.reading import READERS as MESH_READERS
from rigs.shapes.deltas import READERS as DELTA_READERS
from rigs.shapes.deltas import names_in


class Source(NamedTuple):
    """Source of a shape.

    Attributes:
        path: the file.
        is_deltas: whether it contains deltas instead of a mesh.
    """

    path: Path
    is_deltas: bool


def find_shapes(
    folder: str | Path, neutral: str, include: Sequence[str], exclude: Sequence[str], deltas: bool | Sequence[str]
) -> tuple[Path, dict[str, Source]]:
    """File of the neutral, and source of each shape by name.

    Args:
        neutral: the neutral's name or file name.
        include, exclude: globs on names or file names.
        deltas: meshes that contain deltas: all (true), none (false), or those that match globs. Arrays always do.

    Raises:
        InputError: the folder, its neutral or its shapes are missing, two shapes have one name, or a glob matches nothing.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; rig.folder= takes the folder with the neutral and one file for each shape")
    files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    meshes = [path for path in files if path.suffix.lower() in MESH_READERS]
    suffixes = ", ".join((*MESH_READERS, *DELTA_READERS))
    if not meshes:
        content = f"its {len(files)} files are {listed([path.name for path in files])}" if files else "it is empty"
        raise InputError(f"{folder}: no meshes there: {content}; expected a neutral and one file for each shape ({suffixes})")
    neutral_path = _neutral(folder, neutral, meshes)
    readable = [path for path in files if path.suffix.lower() in (*MESH_READERS, *DELTA_READERS)]
    named = [(name, path) for path in readable if path != neutral_path for name in names_in(path)]
    if not named:
        raise InputError(
            f"{folder}: {neutral_path.name} is the only shape there; expected one more file for each shape ({suffixes})"
        )
    _check_globs("include", include, named, folder)
    shapes: dict[str, Path] = {}
    for name, path in named:
        if not _matches(name, path, include) or _matches(name, path, exclude):
            continue
        twin = neutral_path if name == neutral_path.stem else shapes.get(name)
        if twin:
            raise InputError(
                f"{folder}: {twin.name} and {path.name} both hold a shape '{name}': move one out of the folder, or leave it "
                "out with rig.exclude"
            )
        shapes[name] = path
    if not shapes:
        raise InputError(f"{folder}: rig.include and rig.exclude leave no shape but the neutral; widen them")
    globs = ["*"] if deltas is True else list(deltas or [])
    _check_globs("deltas", globs, list(shapes.items()), folder)
    return neutral_path, {
        name: Source(path, path.suffix.lower() in DELTA_READERS or _matches(name, path, globs)) for name, path in shapes.items()
    }


def _neutral(folder: Path, neutral: str, meshes: list[Path]) -> Path:
    for path in meshes:
        if neutral in (path.stem, path.name):
            return path
    names = [path.stem for path in meshes]
    near = difflib.get_close_matches(neutral, names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise InputError(
        f"{folder}: no neutral named '{neutral}' among the {len(names)} meshes there ({listed(names)}): name the rest mesh "
        f"with rig.neutral=NAME{hint}"
    )


def _matches(name: str, path: Path, globs: Sequence[str]) -> bool:
    return any(fnmatchcase(name, glob) or fnmatchcase(path.name, glob) for glob in globs)


def _check_globs(field: str, globs: Sequence[str], named: list[tuple[str, Path]], folder: Path) -> None:
    for glob in globs:
        if not any(_matches(name, path, [glob]) for name, path in named):
            names = listed([name for name, _ in named])
            raise InputError(f"rig.{field}: '{glob}' matches none of the {len(named)} shapes in {folder} ({names})")
