"""Checks before anything starts, of what would fail later."""

import errno
import inspect
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from riginv.config.aliases import upgraded
from riginv.config.building import ClassSpec
from riginv.errors import InputError
from riginv.evaluation.optimum import rig_digest
from riginv.evaluation.results import make_true_rig
from riginv.reproduce.machine import DISTRIBUTIONS, version_of
from riginv.reproduce.rigs import with_workers
from riginv.reproduce.sets import CaptureSource, captured_data
from riginv.reproduce.settings import Budget, TrueRigConfig
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.runs.cache import code_key
from riginv.runs.files import discard
from riginv.runs.run_folder import CONFIG, METRICS, RunFolder, find_run_folder
from riginv.tracking.capture import content_key

PACKAGE = Path(__file__).parent.parent
DRAWING = ("pictures", "plots", "rendering")
WITHOUT_RESULTS = (  # files and folders of the package that results depend on at most through the config of a step
    *(
        "launch",
        "console",
        "progress",
        "checkpoints",
        "reproduce",
        "compare",
        "evaluate",
        "check",
        "inspect",
        "contact_sheet",
        "summary",
        "templates",
        "wording",
    ),
    *("report", "tables", "claims", "machine", "preflight", "running", "plan", "recipes", "expected", "settings"),
)
NETWORK_BYTES = 30_000_000  # of the weights of the largest network
SPARE = 1.2


@dataclass(frozen=True)
class TrueRigChoice:
    """The rig for evaluation.

    Attributes:
        spec: None: the programmatic rig itself.
        why_itself: the reason for that; else empty.
    """

    spec: ClassSpec[RigBackend] | None
    name: str
    why_itself: str = ""


def choose_true_rig(config: TrueRigConfig, rig: LinearRig) -> TrueRigChoice:
    """The true rig, or the programmatic rig where that is chosen or the only one available.

    Raises:
        InputError: the chosen one cannot be built, and is not optional.
    """
    if config.rig is None:
        return TrueRigChoice(None, rig.name, "true_rig=same was chosen")
    try:
        return TrueRigChoice(config.rig, make_true_rig(with_workers(config.rig, 1), rig).name)
    except InputError as error:
        if not config.only_if_here:
            raise
        return TrueRigChoice(None, rig.name, str(error))


def find_folder(path: Path, config: dict[str, Any], resume: bool) -> tuple[RunFolder, str]:
    """The folder of a reproduction, and a note.

    An unfinished reproduction may continue with another config: steps that do not depend on the difference stay valid.

    Raises:
        InputError: the folder holds something else, or a finished reproduction of another config.
    """
    try:
        return find_run_folder(path, config, resume, upgrade=upgraded), ""
    except InputError as error:
        unfinished = (path / "steps").is_dir() and (path / CONFIG).is_file() and not (path / METRICS).is_file()
        if not (resume and unfinished):
            raise
        reason = str(error).partition(": ")[2].partition(";")[0]
        return RunFolder(path, config, resumed=False), f"Continues with another config than before ({reason})."


def check_capture(source: CaptureSource, rig: LinearRig) -> tuple[str | None, MeshSet | None]:
    """The hash of the content of the captured data, None for simulated ones; and the data.

    Raises:
        InputError: the clip cannot be read, or does not fit the rig.
    """
    meshes = captured_data(rig, source)
    return content_key(meshes) if source.path and meshes is not None else None, meshes


def check_folder(folder: RunFolder, rig: RigInMeshSpace, budget: Budget, trainings: int) -> None:
    """Create the folder, and check that it can be written and that its disk has enough free space for `trainings` bundles.

    Raises:
        InputError: it cannot be written, or the space is too little.
    """
    numbers = (rig.space.size + 2 * budget.test_samples / max(trainings, 1)) * 3 * rig.space.vertex_count
    needed = SPARE * trainings * (4 * numbers + 4 * rig.linear_map.numel() + NETWORK_BYTES * min(1.0, rig.space.size / 600))
    there = next(path for path in (folder.path.absolute(), *folder.path.absolute().parents) if path.exists())
    free = shutil.disk_usage(there).free
    kept = sum(path.stat().st_size for path in (folder.path / "steps").rglob("*") if path.is_file())
    if free < needed - kept:
        raise InputError(
            f"{folder.path}: {free / 1e9:.1f} GB are free there, and the steps still need {(needed - kept) / 1e9:.1f} GB: "
            f"free some, or choose another disk with hydra.run.dir=DIR"
        )
    try:
        folder.begin()
        probe = folder.path / ".probe"
        probe.write_bytes(b"riginv" * 1000)
        discard(probe)
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        what = "its disk is full" if full else error.strerror or str(error)
        raise InputError(f"{folder.path} cannot be written: {what}; choose another folder with hydra.run.dir=DIR") from None


def code_hashes(rig: LinearRig, specs: Sequence[ClassSpec[RigBackend] | None]) -> tuple[str, str]:
    """Hashes of all that results depend on, and of the code that draws figures.

    The former: code of riginv and of the rigs, libraries, the built rig, Blender.
    """
    left_out = {*WITHOUT_RESULTS, *DRAWING}
    sources = [path for path in sorted(PACKAGE.rglob("*.py")) if not {path.stem, path.parent.name} & left_out]
    for spec in specs:
        if spec is not None:
            sources += sorted(Path(inspect.getfile(spec.target_class)).parent.rglob("*.py"))
    bpy = version_of("bpy")
    blender = os.environ.get("RIGINV_BLENDER", "") if bpy == "-" else bpy
    drawing = [path for path in sorted(PACKAGE.rglob("*.py")) if path.stem in DRAWING]
    return f"{code_key(sources, DISTRIBUTIONS)}-{rig_digest(rig).hex()[:16]}-{blender}", code_key(drawing, ["matplotlib"])
