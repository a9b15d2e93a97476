"""Payloads that would leave a mark if anything ran them: a file whose path they carry."""

import hashlib
import io
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from riginv.errors import InputError
from riginv.runs.checksums import TEXT_MARK


class Mark:
    """Unpickled, it would make a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return os.system, (f"touch {self.path}",)


def bomb(mark: Path) -> bytes:
    """A pickle that makes the mark, as this test itself sees."""
    data = pickle.dumps(Mark(mark))
    pickle.loads(data)
    assert mark.exists(), "the payload is a dud"
    mark.unlink()
    return data


def torch_bomb(path: Path, mark: Path) -> None:
    """A checkpoint, as torch.save writes it, with the bomb among its values."""
    torch.save({"state_dict": {}, "epoch": 0, "loops": {}, "callbacks": Mark(mark)}, path)


def object_npy(mark: Path) -> bytes:
    """An array of Python objects, one of them the bomb."""
    data = io.BytesIO()
    np.save(data, np.array([Mark(mark)], dtype=object), allow_pickle=True)
    return data.getvalue()


def npz(path: Path, members: dict[str, bytes], kind: int = zipfile.ZIP_STORED) -> None:
    """A zip with members of any name and content."""
    with zipfile.ZipFile(path, "w", kind) as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def npy(array: np.ndarray) -> bytes:
    data = io.BytesIO()
    np.save(data, array)
    return data.getvalue()


def yaml_run(mark: Path) -> str:
    """A tag that YAML's unsafe loader would run."""
    return f"!!python/object/apply:os.system ['touch {mark}']\n"


def script_of(mark: Path) -> dict:
    """A class of ours that starts a program, as a config would name it."""
    return {"_target_": "riginv.runs.worker_process.WorkerProcess", "command": ["touch", str(mark)]}


def sentence(read: Callable[[], Any], says: str = ".") -> None:
    with pytest.raises(InputError, match=says) as refusal:
        read()
    assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 1000


def signed(config: str) -> str:
    """A run's config.yaml with the checksum that belongs to it, as who means harm would write it."""
    return f"{config}{TEXT_MARK}{hashlib.sha256(config.encode()).hexdigest()}\n"
