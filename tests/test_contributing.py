"""The recipes of CONTRIBUTING.md, taken from the page and run."""

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from riginv.animation import formats
from riginv.animation.animation import Animation
from riginv.clips import open as opening
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.errors import InputError
from riginv.rig.contract import check_rig
from tests.conftest import ROOT, SMALL

PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^`([\w/.]+)`:\n\n```\w+\n(.*?)```", PAGE, re.MULTILINE | re.DOTALL))
REGISTRATIONS = re.findall(r"^Register it[^\n]*:\n\n```python\n(.*?)```", PAGE, re.MULTILINE | re.DOTALL)
COMMANDS = re.findall(r"^Run it[^\n]*:\n\n```bash\n(.*?)```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The files of the page in an empty folder, from which Python imports; those within `riginv` become part of it."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    for package in ("clips", "animation"):
        folders = importlib.import_module(f"riginv.{package}").__path__
        monkeypatch.setattr(f"riginv.{package}.__path__", [*folders, str(tmp_path / "riginv" / package)])
    yield tmp_path
    for name in FILES:
        sys.modules.pop(name.removesuffix(".py").replace("/", "."), None)


def register(folder: Path, block: str) -> None:
    (folder / "registering.py").write_text(block)
    importlib.import_module("registering")
    del sys.modules["registering"]


def test_the_rig_keeps_the_contract(written):
    module = importlib.import_module("my_rigs.ripple")
    rig = module.RipplePlate(edge_mm=80.0)
    check_rig(rig)
    assert rig.rest_vertices.shape == (144, 3) and len(rig.faces) == 242
    assert float(np.ptp(rig.rest_vertices[:, 0].numpy())) == pytest.approx(80.0)


def test_the_reader_reads_and_refuses(written, monkeypatch):
    monkeypatch.setattr(opening, "READERS", dict(opening.READERS))
    register(written, REGISTRATIONS[0])
    rig = importlib.import_module("my_rigs.ripple").RipplePlate()
    meshes = rig(torch.rand(5, 3)).numpy().astype("<f4")
    path = written / "take.xyz"
    path.write_bytes(b"XYZ 144 24\n" + meshes.tobytes())
    clip, _ = opening.open_clip(str(path), rig, ReadingOptions(), FrameOptions())
    assert len(clip) == 5 and clip.fps == 24
    np.testing.assert_array_equal(clip.vertices(1, 4), meshes[1:4])
    for damaged in (path.read_bytes()[:-5], b"XYZ 0 24\n", b"XYZ 1\n", b"\xff\xfe", b""):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"take\.xyz: "):
            opening.open_clip(str(path), rig, ReadingOptions(), FrameOptions())


def test_the_format_is_written(written, monkeypatch):
    monkeypatch.setattr(formats, "FORMATS", dict(formats.FORMATS))
    register(written, REGISTRATIONS[1])
    rig = importlib.import_module("my_rigs.ripple").RipplePlate()
    formats.check_formats(rig, ["json"])
    animation = Animation(rig, torch.tensor([[0.0, 0.25, 0.5], [1.0, 0.5, 0.0]]), 24.0, torch.arange(2))
    chosen = formats.FORMATS["json"]
    chosen.write(written / chosen.file, animation)
    assert json.loads((written / chosen.file).read_text()) == {
        "fps": 24.0,
        "frames": [0, 1],
        "curves": {"bulge": [0.0, 1.0], "ripple": [0.25, 0.5], "both": [0.5, 0.0]},
    }


def test_the_method_is_compared_on_the_rig(written, run, few_optima):
    shutil.copytree(written / "my_rigs/conf/rig", written / "my_methods/conf/rig")
    done = run("compare", f"--config-dir={written / 'my_methods/conf'}", "methods=[nearest,neutral]", "rig=ripple", "poses=6")
    assert done.code == 0, done.text
    table = (done.folder / "compare.md").read_text()
    assert "nearest" in table and "neutral" in table


@pytest.mark.slow
def test_the_commands_of_the_page_run(written):
    small = [argument for argument in SMALL if not argument.startswith(("rig=", "--"))]
    for command in "\n".join(COMMANDS).splitlines():
        arguments = [*small, "hydra.run.dir=run"] if "riginv.train" in command else []
        done = subprocess.run(
            ["bash", "-c", " ".join([command, *arguments])],
            cwd=written,
            env={**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
