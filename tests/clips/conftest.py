"""A toy rig and a performance of it."""

import numpy as np
import pytest

from tests.support.clips import (
    performance,
)
from tests.support.toys import ToyRig


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig(arkit=True)


@pytest.fixture(scope="module")
def meshes(rig) -> np.ndarray:
    return performance(rig)
