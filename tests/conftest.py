"""Rigs built once, and command lines run within the test's process."""

import json
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from hydra._internal.hydra import Hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from jaxtyping import install_import_hook

from tests.support import shape_checks

SHAPES = [f"riginv.{package}" for package in ("rig", "geometry", "networks", "sampling", "solvers")]
if os.environ.get("RIGINV_SHAPES") == "1":  # as the gate does for the tests of these packages: it takes half as long again
    install_import_hook(SHAPES, f"{shape_checks.__name__}.check_shapes")  # before these are imported

from riginv import (
    check,
    compare,
    contact_sheet,
    evaluate,
    export_onnx,
    inspect,
    invert,
    learn_prior,
    markers,
    missing,
    sample,
    train,
    wrap,
)
from riginv.evaluation import optimum
from riginv.launch.command import command
from riginv.reproduce.__main__ import reproduce
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from rigs.blender import export as export_blender
from rigs.body import BodyRig
from rigs.dna import copy as copy_dna
from rigs.dna import evaluate as evaluate_dna
from rigs.dna import export as export_dna
from rigs.dna import gui as gui_dna
from rigs.face import FaceRig
from tests.support.toys import ToyRig

ROOT = Path(__file__).parent.parent
COMMANDS = {
    "train": train.train,
    "evaluate": evaluate.evaluate,
    "check": check.check,
    "compare": compare.compare,
    "contact_sheet": contact_sheet.contact_sheet,
    "inspect": inspect.inspect,
    "invert": invert.invert,
    "learn_prior": learn_prior.learn,
    "markers": markers.run,
    "wrap": wrap.run,
    "missing": missing.run,
    "export_onnx": export_onnx.export_onnx,
    "reproduce": reproduce,
    "sample": sample.sample,
    "copy_dna": copy_dna.copy,
    "evaluate_dna": evaluate_dna.evaluate,
    "export_dna": export_dna.export,
    "gui_dna": gui_dna.gui,
    "export_blender": export_blender.export,
}
LEAVE_NO_FOLDER = (
    "check",
    "contact_sheet",
    "inspect",
    "invert",
    "learn_prior",
    "markers",
    "missing",
    "sample",
    "wrap",
    "copy_dna",
    "evaluate_dna",
    "export_dna",
    "gui_dna",
    "export_blender",
)
SETS_MODE = ("-m", "--multirun", "hydra.mode")  # no config of ours does
SMALL = [
    "rig=toy",
    f"--config-dir={ROOT / 'tests/conf'}",
    "model.network.hidden=[32]",
    "surrogate.network.hidden=[32]",
    "trainer.max_steps=12",
    "trainer.log_every_n_steps=1",
    "data.steps_per_epoch=6",
    "data.batch_size=8",
    "evaluation.test_poses=20",
    "evaluation.validation_poses=4",
    "checkpoint.every_n_steps=5",
    "pictures.every_n_validations=null",
    "pictures.final=false",  # two seconds
]


@dataclass
class Outcome:
    """What a command line did: its exit code, all it printed, and the folder it was given."""

    code: int
    text: str
    folder: Path

    @property
    def metrics(self) -> dict:
        return json.loads((self.folder / "metrics.json").read_text())


@pytest.fixture(autouse=True)
def drawn_alike() -> None:
    """A test draws the same numbers every time, whatever ran before it."""
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def face() -> FaceRig:
    return FaceRig()


@pytest.fixture(scope="session")
def face_in_space(face: FaceRig) -> RigInMeshSpace:
    return RigInMeshSpace(face, MeshSpace.from_rig(face))


@pytest.fixture(scope="session")
def body() -> BodyRig:
    return BodyRig()


@pytest.fixture(scope="session")
def body_in_space(body: BodyRig) -> RigInMeshSpace:
    return RigInMeshSpace(body, MeshSpace.from_rig(body))


@pytest.fixture(scope="session")
def toy() -> RigInMeshSpace:
    rig = ToyRig()
    return RigInMeshSpace(rig, MeshSpace.from_rig(rig))


@pytest.fixture
def run(tmp_path: Path, capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Outcome]:
    """Run a command line as `python -m riginv.NAME` would, small unless told otherwise, in a folder of its own."""

    def run_command(name: str, *arguments: str, small: bool = True, folder: str = "run") -> Outcome:
        target = tmp_path / folder
        given = [*(SMALL if small and name == "train" else []), *arguments]
        named = any(argument.startswith(("hydra.run.dir", "hydra.sweep.dir")) for argument in given)
        if not named and name not in LEAVE_NO_FOLDER:
            given.append(f"hydra.run.dir={target}")
        monkeypatch.setattr(sys, "argv", [f"riginv.{name}", *given])
        monkeypatch.chdir(tmp_path)
        capfd.readouterr()
        GlobalHydra.instance().clear()
        code = 0
        with monkeypatch.context() as patched:
            patched.setattr(HydraConfig.instance(), "cfg", None)  # --help would leave its config to the tests that follow
            if not any(argument.startswith(SETS_MODE) for argument in given):  # then Hydra would compose all for this answer
                patched.setattr(Hydra, "get_mode", lambda *args, **kwargs: RunMode.RUN)
            try:
                command(name)(COMMANDS[name])()
            except SystemExit as stop:
                code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
            finally:
                torch.use_deterministic_algorithms(False)
        out, err = capfd.readouterr()
        return Outcome(code, out + err, target)

    return run_command


@pytest.fixture
def few_optima(monkeypatch: pytest.MonkeyPatch) -> None:
    """The optimum of a set from 4 of its meshes: it takes longer than all else that a command of a test does."""
    monkeypatch.setattr(optimum, "MESHES", 4)


@pytest.fixture
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache of the test's own, empty."""
    monkeypatch.setenv("RIGINV_CACHE", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture
def mark(tmp_path: Path) -> Iterator[Path]:
    """The file that a payload would make; no test leaves it behind."""
    path = tmp_path / "ran"
    yield path
    assert not path.exists(), "the payload ran"


@pytest.fixture(scope="session")
def capture_file() -> Path:
    """The shared captured clip; tests that need it are skipped where it is absent."""
    path = Path(os.environ.get("RIGINV_SHARED", ROOT.parent / "shared")) / "capture/live_link_face_rom.csv"
    if not path.is_file():
        pytest.skip(f"the captured clip is not here: {path}")
    return path
