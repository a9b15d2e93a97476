"""A complete store, and copies of it."""

import shutil
from pathlib import Path

import pytest

from riginv.sampling.store.summary import finish
from tests.sampling.store.support import filled


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "whole.zarr"
    finish(filled(path))
    return path


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "copy.zarr"))
