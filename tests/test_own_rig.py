"""A user's own rig: a class and a YAML outside the tree, with riginv installed from its wheel."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.conftest import ROOT, SMALL

PUPPET = """
import torch
from riginv.rig import Control, LinearRig

class Puppet(LinearRig):
    def __init__(self, size: float) -> None:
        rest = torch.tensor([[0.0, 0, 0], [size, 0, 0], [0, size, 0], [0, 0, size]])
        faces = torch.tensor([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
        deltas = torch.zeros(2, 4, 3)
        deltas[0, 1, 0], deltas[1, 2, 1] = size / 2, size / 3
        controls = [Control("wide"), Control("tall", lower=-1.0), Control("both")]
        super().__init__("puppet", controls, rest, faces, basis=deltas, primary_count=2)

    def coefficients(self, controls: torch.Tensor) -> torch.Tensor:
        wide, tall, both = controls.T
        return torch.stack([1 - (1 - wide) * (1 - both), tall.abs() * (1 - both) + both], dim=1)
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """What the wheel installs, unpacked: no checkout in sight."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(ROOT)]
    subprocess.run(build, check=True)
    with zipfile.ZipFile(next(folder.glob("riginv-*.whl"))) as wheel:
        wheel.extractall(folder / "site")
    return folder / "site"


def test_the_wheel_holds_code_and_configs_and_nothing_else(installed):
    assert {path.name for path in installed.iterdir() if not path.name.endswith(".dist-info")} == {"riginv", "rigs"}
    assert (installed / "riginv/conf/rig/face.yaml").is_file() and (installed / "riginv/conf/train.yaml").is_file()


def test_a_rig_of_ones_own_is_checked_trained_and_evaluated_from_any_directory(installed, tmp_path):
    (tmp_path / "studio").mkdir()
    (tmp_path / "studio/puppet.py").write_text(PUPPET)
    (tmp_path / "configs/rig").mkdir(parents=True)
    (tmp_path / "configs/rig/puppet.yaml").write_text("_target_: studio.puppet.Puppet\nsize: 100.0\n")
    environment = {**os.environ, "PYTHONPATH": f"{installed}:{tmp_path}"}

    def riginv(name: str, *arguments: str) -> str:
        command = [sys.executable, "-m", f"riginv.{name}", "--config-dir", "configs", *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    small = [argument for argument in SMALL if not argument.startswith(("rig=", "--config-dir"))]
    assert riginv("check", "rig=puppet").count("holds") == 7
    assert "true rig, puppet" in riginv("train", "rig=puppet", *small, "hydra.run.dir=run")
    assert "true rig, puppet" in riginv("evaluate", "bundle=run", "rig=puppet", "poses=10", "hydra.run.dir=judged")
    assert (tmp_path / "judged/metrics.json").is_file()
