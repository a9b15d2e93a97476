"""A user's own rig: the page that makes one, followed to the letter, with riginv installed from its wheel."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from scipy.spatial.transform import Rotation

from riginv.rig.contract import check_rig
from tests.conftest import ROOT, SMALL

PAGE = (ROOT / "docs/your-own-rig.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^`(cube_rig/[^`]+)`:\n\n```\w+\n(.*?)```", PAGE, re.MULTILINE | re.DOTALL))
COMMANDS = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)[0].splitlines()
SCRIPT = next(block for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) if "load_inverse" in block)


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """What the wheel installs, unpacked: no checkout in sight."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder)]
    subprocess.run([*build, str(ROOT)], check=True)
    with zipfile.ZipFile(next(folder.glob("riginv-*.whl"))) as wheel:
        wheel.extractall(folder / "site")
    return folder / "site"


def test_the_wheel_holds_code_and_configs_and_nothing_else(installed):
    assert {path.name for path in installed.iterdir() if not path.name.endswith(".dist-info")} == {
        "riginv",
        "rigs",
        "hydra_plugins",
    }
    assert (installed / "riginv/conf/rig/face.yaml").is_file() and (installed / "riginv/conf/train.yaml").is_file()


def test_the_page_shows_the_example_as_it_is():
    example = ROOT / "examples/cube_rig"
    there = {path.relative_to(example.parent).as_posix(): path for path in example.rglob("*") if path.is_file()}
    assert set(FILES) == {name for name in there if "__pycache__" not in name}
    for name, text in FILES.items():
        assert text == there[name].read_text(encoding="utf-8"), name


def test_the_cube_equals_its_definition_and_keeps_the_contract(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "examples/cube_rig")
    from cube_rig.cube import CubeRig

    rig = CubeRig(
        **{key: value for key, value in yaml.safe_load(FILES["cube_rig/conf/rig/cube.yaml"]).items() if key == "size"}
    )
    check_rig(rig)
    corners = np.array([[x, y, z] for x in (-50, 50) for y in (-50, 50) for z in (-50, 50)])
    assert len(np.unique(rig.rest_vertices, axis=0)) == 8
    np.testing.assert_array_equal(rig.rest_vertices, corners)
    draw = np.random.default_rng(0)
    controls = draw.uniform(rig.lower, rig.upper, size=(20, 6))
    for row, found in zip(controls, rig(torch.tensor(controls))):
        turn = Rotation.from_euler("xyz", row[:3], degrees=True)
        np.testing.assert_allclose(found, turn.apply(corners * row[3:]), atol=1e-4)


@pytest.mark.parametrize("commands", [COMMANDS[:2] + COMMANDS[3:], pytest.param([*COMMANDS, SCRIPT], marks=pytest.mark.slow)])
def test_a_reader_who_types_what_the_page_says_gets_a_trained_inverse(installed, tmp_path, commands):
    """The files and commands of the page, in an empty folder; only numbers of steps and poses are made small.

    Every process takes seconds to import torch: the picture and the script are left to the slow run.
    """
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    small = dict(argument.split("=") for argument in SMALL if not argument.startswith(("rig=", "--")))
    (tmp_path / "cube_rig/conf/local").mkdir()
    values = "".join(f"{key}: {value}\n" for key, value in {**small, "poses": 10, "random_poses": 1}.items())
    (tmp_path / "cube_rig/conf/local/default.yaml").write_text("# @package _global_\n" + nested(values))
    site = tmp_path / "site"
    pip = {"PIP_TARGET": str(site), "PIP_NO_DEPS": "1", "PIP_NO_BUILD_ISOLATION": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, **pip, "PATH": path, "PYTHONPATH": f"{installed}:{site}"}

    said = {}
    for command in commands:
        shell = [sys.executable, "-c"] if command == SCRIPT else ["bash", "-c"]
        done = subprocess.run([*shell, command], cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        said[" ".join(command.split()[:3])] = done.stdout
        if command.startswith("pip"):
            (tmp_path / "cube_rig/cube_rig/cube.py").unlink()  # from here on only the installed package can answer
    assert said["python -m riginv.check"].count("holds") == 7
    assert "true rig, cube" in said["python -m riginv.train"] and "12 steps" in said["python -m riginv.train"]
    assert "true rig, cube" in said["python -m riginv.evaluate"]
    assert (tmp_path / "cube-judged/metrics.json").is_file()
    if SCRIPT in commands:
        assert (tmp_path / "cube.png").is_file() and done.stdout.startswith("tensor([[")


def nested(values: str) -> str:
    """YAML with dotted keys as YAML with one level for each part."""
    tree: dict = {}
    for key, value in yaml.safe_load(values).items():
        *parents, last = key.split(".")
        place = tree
        for parent in parents:
            place = place.setdefault(parent, {})
        place[last] = value
    return yaml.safe_dump(tree)
