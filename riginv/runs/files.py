"""Atomic writes and checked reads of files."""

import difflib
import json
import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import yaml

from riginv.errors import InputError, in_short

MOST_YAML_BYTES = 1 << 26
MOST_YAML_VALUES = 300_000  # once everything that is referred to again has been counted again


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` when the block succeeds, remove it otherwise."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield beside
        if path.is_dir():
            discard(path)
        os.replace(beside, path)
    finally:
        discard(beside)


def free_folder(out: str) -> Path:
    """The folder `out` for results.

    Raises:
        InputError: it exists and is not an empty folder.
    """
    path = Path(out)
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise InputError(f"out={out}: it is there already; give another folder, or remove it")
    return path


def free_file(out: str, suffix: str = "", *beside: str) -> Path:
    """The file `out` for a result.

    Args:
        suffix: the suffix that it must have; empty: any.
        beside: suffixes of files that are written next to it.

    Raises:
        InputError: it has another suffix, or one of them exists.
    """
    path = Path(out)
    if suffix and path.suffix.lower() != suffix:
        raise InputError(f"out={out}: expected the name of a file that ends in {suffix}")
    for file in (path, *(path.with_suffix(suffix) for suffix in beside)):
        if file.exists():
            raise InputError(f"out={out}: {'it' if file == path else file} is there already; give another name, or remove it")
    return path


def stale_partial_files(path: Path) -> list[Path]:
    """Partial files and folders that killed processes left beside a file or a folder."""
    part = re.compile(rf"\.{re.escape(path.name)}\.\d+\.part(\..+)?")
    return [beside for beside in path.parent.iterdir() if part.fullmatch(beside.name)] if path.parent.is_dir() else []


def discard(path: Path) -> None:
    """Remove a file or a folder, if it exists; a link is removed, not its target."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    with atomic_write(path) as beside:
        beside.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file atomically."""
    write_text(path, json.dumps(content, indent=2) + "\n")


def is_file(path: Path) -> bool:
    """Whether a file exists; False for names that the system does not allow."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def check_regular(path: Path) -> None:
    """Raises InputError where a path leads to a device, which might never end, or to a pipe, which might never start."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return  # an error when it is opened
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise InputError(f"{path}: this is no file but a device, a pipe or a socket, which are never read: name a file")


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """A file open for reading bytes.

    Raises:
        InputError: it is not there, or cannot be read.
    """
    check_regular(path)
    try:
        with path.open("rb") as file:
            yield file
    except FileNotFoundError:
        raise InputError(f"{path}: no such file{_near(path)}") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None


def _near(path: Path) -> str:
    """The end of a sentence about a file that is not there: files of nearly this name, or that its folder is not there, too."""
    try:
        names = os.listdir(path.parent)
    except (OSError, ValueError):
        return f", and no folder {path.parent}"
    near = difflib.get_close_matches(path.name, names, n=3, cutoff=0.7)
    return f"; did you mean {' or '.join(near)}?" if near else ""


def read_bytes(path: Path) -> bytes:
    """All bytes of a file.

    Raises:
        InputError: it is not there, or cannot be read.
    """
    with opened(path) as file:
        return file.read()


def read_text(path: Path) -> str:
    """The text of a file that is untrusted.

    Raises:
        InputError: it is missing, no file, no text, or larger than such files are.
    """
    check_regular(path)
    try:
        if path.stat().st_size > MOST_YAML_BYTES:
            raise InputError(
                f"{path}: {path.stat().st_size:,} bytes, expected at most {MOST_YAML_BYTES:,}: this is not that file"
            )
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file{_near(path)}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {in_short(error)}") from None


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file that is untrusted: plain values, and no more of them than could be meant.

    Raises:
        InputError: the file is missing or damaged, asks for Python objects, holds no mapping, or expands beyond all bounds.
    """
    text = read_text(path)
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: cannot be read as YAML of plain values: {in_short(error)}") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds {type(content).__name__}, expected names, each with a value: truncated or altered")
    check_values(path, content)
    return content


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file that is untrusted.

    Raises:
        InputError: the file is missing or damaged, or holds something else.
    """
    text = read_text(path)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read as JSON: {in_short(error)}: truncated or altered") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds {type(content).__name__}, expected names, each with a value: truncated or altered")
    return content


def check_values(path: Path, content: Any) -> None:
    """Raises InputError where values are far more, or nested far deeper, than could be meant: aliases in YAML multiply them."""
    waiting, seen = [iter([content])], 0
    while waiting:
        value = next(waiting[-1], waiting)
        if value is waiting:
            waiting.pop()
            continue
        seen += 1
        if seen > MOST_YAML_VALUES or len(waiting) > 100:
            raise InputError(f"{path}: holds more values, or nested deeper, than could be meant: its aliases multiply them")
        if isinstance(value, dict | list):
            waiting.append(iter(value.values() if isinstance(value, dict) else value))
