"""Training in bfloat16 and in compiled code."""

import pytest
import torch
from safetensors.torch import load_file

from riginv.networks.base import use_bfloat16
from riginv.networks.inverse import StagedInverse
from tests.training.test_devices import apart


def test_bfloat16_stays_out_of_the_rig(face_in_space):
    torch.manual_seed(0)
    size = face_in_space.space.size
    network = StagedInverse(face_in_space, hidden=(32,), refinement_steps=1, width=16, gate=16, coordinates=size)
    coordinates = 10 * torch.randn(4, size)
    network.calibrate(coordinates)
    with torch.no_grad():
        for part in network.learned_parts():
            for weight in part.parameters():
                weight.mul_(3)
    exact = network.estimates(coordinates)
    use_bfloat16(network)
    rounded = network.estimates(coordinates)
    for full, half in zip(exact, rounded):
        assert 1e-6 < (full.controls - half.controls).abs().max() < 0.1  # bfloat16 it is
        assert half.controls.dtype == half.coordinates.dtype == torch.float32
        assert torch.equal(half.coordinates, face_in_space(half.controls))
    assert torch.equal(network(torch.zeros(1, face_in_space.space.size)), face_in_space.source.neutral_controls[None])
    with torch.autocast("cpu", torch.bfloat16):
        wrong = face_in_space(half.controls).float()
    off = (face_in_space.space.decode(wrong) - face_in_space.space.decode(half.coordinates)).norm(dim=2)
    assert off.max() > 0.01  # mm: what a rig in bfloat16 would be off by


def test_training_as_on_a_gpu_in_bfloat16_ends_in_a_bundle_of_float32(run):
    outcome = run("train", "trainer=gpu", "trainer.accelerator=cpu", "trainer.precision=bf16-mixed")
    assert outcome.code == 0, outcome.text
    weights = load_file(outcome.folder / "bundle/weights.safetensors")
    assert {value.dtype for value in weights.values()} == {torch.float32}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*torch.jit.script_method.*:DeprecationWarning")  # of PyTorch 2.13's compiler itself
def test_compiled_training_leaves_the_same_bundle(run):
    plain = run("train", "model.network.refinement_steps=1", folder="plain")
    compiled = run("train", "model.network.refinement_steps=1", "trainer.compile=true", folder="compiled")
    assert plain.code == compiled.code == 0, compiled.text
    assert apart(plain.folder, compiled.folder) < 1e-3
    resumed = run("train", "model.network.refinement_steps=1", "trainer.compile=true", "resume=true", folder="compiled")
    assert resumed.code == 0 and resumed.metrics == compiled.metrics
