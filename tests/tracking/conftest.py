"""Fixtures of the tests of tracking."""

import pytest
import torch

from tests.support.clips import performance
from tests.support.toys import ToyRig


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig(arkit=True)


@pytest.fixture(scope="module")
def meshes(rig) -> torch.Tensor:
    return torch.tensor(performance(rig), dtype=torch.float32)
