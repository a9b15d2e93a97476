"""An inverse as ONNX: onnxruntime gives what PyTorch gives, for any number of meshes."""

import json
import sys

import pytest
import torch

from riginv.errors import InputError
from riginv.export_onnx import check_packages, random_meshes, write_onnx
from riginv.inference.bundle import write_bundle
from riginv.inference.inverse import Inverse
from riginv.networks.inverse import DirectInverse, StagedInverse
from tests.conftest import ROOT

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript")


def inverse_of(network):
    """An inverse whose answers differ from mesh to mesh, as a trained one's do."""
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in network.own_weights().values():
            if parameter.ndim == 2:
                parameter.copy_(torch.randn(parameter.shape, generator=generator) / parameter.shape[1] ** 0.5)
    return Inverse(network).eval().requires_grad_(False)


STAGED = [{"stages": 2, "distance_steps": 0}, {"distance_steps": 1}]  # further steps on meshes of the rig multiply rounding


@pytest.mark.parametrize(
    ("kind", "options"),
    [*(pytest.param(StagedInverse, options, marks=pytest.mark.slow) for options in STAGED), (DirectInverse, {})],
)
def test_onnxruntime_agrees(kind, options, toy, tmp_path):
    inverse = inverse_of(kind(toy, hidden=(24,), **options))
    if kind is StagedInverse:
        inverse.network.calibrate(toy.space.encode(random_meshes(inverse, 64)))
    path = tmp_path / "toy.onnx"
    parity = write_onnx(path, inverse)
    assert parity.vertex_mm < 0.001 and parity.control_fraction < 1e-4
    onnx.checker.check_model(str(path), full_check=True)
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    meshes = random_meshes(inverse, 9)
    assert float((inverse(meshes) - toy.source.neutral_controls).abs().max()) > 0.05
    for count in (1, 2, 9):
        found = torch.tensor(session.run(None, {"vertices": meshes[:count].numpy()})[0])
        assert torch.allclose(found, inverse(meshes[:count]), atol=1e-4)
    facts = session.get_modelmeta().custom_metadata_map
    assert [control["name"] for control in json.loads(facts["controls"])] == list(toy.source.control_names)
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_answers_otherwise_is_not_written(toy, tmp_path, monkeypatch):
    inverse = inverse_of(DirectInverse(toy, hidden=(8,)))
    monkeypatch.setattr("riginv.export_onnx.LARGEST_DIFFERENCE", -1.0)
    with pytest.raises(InputError, match="not written: onnxruntime's answers differ"):
        write_onnx(tmp_path / "toy.onnx", inverse)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_traced_is_a_sentence(toy, tmp_path):
    class Looking(DirectInverse):
        def forward(self, coordinates):
            return super().forward(coordinates) * (2.0 if coordinates.sum() > 0 else 1.0)

    with pytest.raises(InputError, match="cannot be traced into ONNX"):
        write_onnx(tmp_path / "toy.onnx", inverse_of(Looking(toy, hidden=(8,))))
    assert not list(tmp_path.iterdir())


@pytest.fixture
def bundle(toy, tmp_path):
    network = {"_target_": "riginv.networks.inverse.DirectInverse", "hidden": [8]}
    inverse = inverse_of(DirectInverse(toy, hidden=(8,)))
    config = {"model": {"network": network}, "rig": {"_target_": "tests.support.toys.ToyRig"}}
    write_bundle(tmp_path / "bundle", "inverse", inverse.network, toy, config["model"]["network"], config["rig"], {})
    return tmp_path / "bundle"


def test_the_command(run, bundle, tmp_path):
    out = tmp_path / "toy.onnx"
    found = run("export_onnx", f"bundle={bundle}", f"out={out}", "rig=toy", f"--config-dir={ROOT / 'tests/conf'}", "poses=5")
    assert found.code == 0, found.text
    assert out.is_file() and "5 random poses" in found.text
    found = run("export_onnx", f"bundle={bundle}", "out=toy.txt", "rig=toy", f"--config-dir={ROOT / 'tests/conf'}")
    assert found.code == 1 and "out=toy.txt: expected the name of a file that ends in .onnx" in found.text
    found = run("export_onnx", "bundle=nowhere", "out=other.onnx")
    assert found.code == 1 and "nowhere: no bundle there" in found.text and "Traceback" not in found.text


def test_missing_packages_are_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(InputError, match=r"packages onnxscript: pip install 'riginv\[onnx\]'"):
        check_packages()
