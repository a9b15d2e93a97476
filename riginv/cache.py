"""Tensors that take seconds to build, kept between runs."""

import hashlib
import importlib.metadata
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import platformdirs
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor


def cache_folder() -> Path:
    """Where riginv keeps what it can build again: `$RIGINV_CACHE`, or the user's cache folder."""
    return Path(os.environ.get("RIGINV_CACHE") or platformdirs.user_cache_dir("riginv"))


def code_key(sources: Sequence[Path], distributions: Sequence[str] = ()) -> str:
    """A key that changes with the code that builds something, and with the data that it is built from.

    Args:
        sources: Python files, and folders of them: everything that the building code imports and that may change.
        distributions: installed packages, whose versions count.
    """
    digest = hashlib.sha256()
    for source in sources:
        for path in [source] if source.is_file() else sorted(source.glob("*.py")):
            digest.update(path.read_bytes())
    for name in distributions:
        digest.update(importlib.metadata.version(name).encode())
    return digest.hexdigest()[:16]


def cached_tensors(name: str, key: str, build: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
    """The tensors kept as `name` under `key`, or else those that `build` makes, which are then kept.

    A damaged file is built anew; where nothing can be written the tensors are built every time.
    """
    path = cache_folder() / f"{name}-{key}.safetensors"
    try:
        return load_file(path)
    except (OSError, SafetensorError):
        pass
    tensors = build()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            save_file(tensors, Path(folder) / path.name)
            (Path(folder) / path.name).replace(path)
    except OSError:
        pass
    return tensors
