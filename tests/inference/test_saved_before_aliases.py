"""Bundles that were saved before classes and arguments were renamed: they load, and give the same controls to the last bit."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from riginv.evaluation.models import load_model
from riginv.inference.inverse import load_inverse
from tests.support.toys import ToyRig

SAVED = Path(__file__).parent / "saved_before_aliases"  # by commit ecc3cdc, of toys trained for 12 steps


@pytest.fixture
def saved() -> dict[str, Tensor]:
    """What the bundles gave when they were saved, on one thread, by the name of each, and `vertices`, `controls`, `probe`."""
    return {name: torch.from_numpy(values) for name, values in np.load(SAVED / "expected.npz").items()}


@pytest.fixture
def in_torch_on_one_thread(monkeypatch):
    """Compiled kernels round the rig's arithmetic otherwise, and so do several threads."""
    monkeypatch.setenv("RIGINV_KERNELS", "0")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def probe(vertices: Tensor) -> Tensor:
    """The kinds of arithmetic in a network: where these bits are the saved ones, this machine rounds as that one did."""
    values = (vertices - vertices.mean(dim=0)).flatten(1)
    for _ in range(3):
        mixed = values @ values.T / values.square().sum(dim=1)
        values = torch.tanh(torch.nn.functional.gelu(mixed) @ values / values.std())
    return values


def assert_same(found: Tensor, expected: Tensor, saved: dict[str, Tensor]) -> None:
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)
    if torch.equal(probe(saved["vertices"]), saved["probe"]):
        assert torch.equal(found, expected)


@pytest.mark.parametrize("name", ["staged", "direct"])
def test_inverses_give_the_same_controls(name, saved, in_torch_on_one_thread):
    assert_same(load_inverse(SAVED / name, ToyRig())(saved["vertices"]), saved[name], saved)


def test_a_surrogate_gives_the_same_vertices(saved, in_torch_on_one_thread):
    with torch.no_grad():
        assert_same(load_model(SAVED / "forward")(saved["controls"]), saved["forward"], saved)
