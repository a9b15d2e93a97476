"""Tensors that take seconds to build, kept between runs."""

import contextlib
import hashlib
import importlib.metadata
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import platformdirs
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from riginv.errors import InputError
from riginv.runs.checksums import tensors_sha256
from riginv.runs.files import atomic_write
from riginv.runs.locks import exclusive_lock

SUM = "sha256"


def cache_folder() -> Path:
    """The folder of what riginv can build again: `$RIGINV_CACHE`, or the user's cache folder."""
    return Path(os.environ.get("RIGINV_CACHE") or platformdirs.user_cache_dir("riginv"))


def code_key(sources: Sequence[Path], distributions: Sequence[str] = ()) -> str:
    """A key that changes with the code that builds something, and with the data that it is built from.

    Args:
        sources: Python files, and folders of them: everything that the building code imports and that may change.
        distributions: installed packages, whose versions count.

    Raises:
        FileNotFoundError: a source does not exist: the key would not change with it.
    """
    digest = hashlib.sha256()
    for source in sources:
        paths = [source] if source.is_file() else sorted(source.glob("*.py"))
        if not paths:
            raise FileNotFoundError(f"{source}: neither a Python file nor a folder of some: correct the sources of this key")
        for path in paths:
            digest.update(path.read_bytes())
    for name in distributions:
        digest.update(importlib.metadata.version(name).encode())
    return digest.hexdigest()[:16]


def cached_tensors(name: str, key: str, build: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
    """The tensors kept as `name` under `key`, or else those that `build` makes, which are then kept.

    A damaged file, found by its checksum, is built again; where nothing can be written the tensors are built every time.
    """
    path = cache_folder() / f"{name}-{key}.safetensors"
    tensors = _read(path)
    if tensors is None:
        tensors = build()
        with contextlib.suppress(OSError, SafetensorError, InputError):  # the last: another process keeps the same just now
            with exclusive_lock(path), atomic_write(path) as beside:
                save_file(tensors, beside, {SUM: tensors_sha256(tensors)})
    # Sums of floats depend on how their memory is aligned: copies are aligned alike, whether built or read.
    return {name: tensor.clone() for name, tensor in tensors.items()}


def _read(path: Path) -> dict[str, Tensor] | None:
    try:
        with safe_open(path, "pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}
            kept = (file.metadata() or {}).get(SUM)
    except (OSError, SafetensorError):
        return None
    return tensors if kept == tensors_sha256(tensors) else None
