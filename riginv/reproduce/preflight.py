"""What could go wrong an hour in, looked at before anything starts."""

import errno
import importlib.metadata
import inspect
import os
import shutil
from pathlib import Path

from riginv.clips.options import clip_options
from riginv.config.aliases import upgraded
from riginv.config.building import ClassSpec, build, class_of
from riginv.errors import InputError
from riginv.evaluation.optimum import fingerprint
from riginv.evaluation.results import make_true_rig
from riginv.reproduce.recipes import ITSELF, Config, test_samples
from riginv.reproduce.sets import recording
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.runs.cache import code_key
from riginv.runs.files import discard
from riginv.runs.run_folder import CONFIG, METRICS, RunFolder, find_run_folder
from riginv.tracking.capture import content_key

PACKAGE = Path(__file__).parent.parent
DRAWING = ("pictures", "plots", "rendering")
MAKE_NO_FIGURES = (  # files and folders of the package that no result of a step depends on but through its config
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
    *("report", "tables", "claims", "machine", "preflight", "running", "workers", "plan", "recipes", "expected"),
)
DISTRIBUTIONS = ("torch", "numpy", "scipy", "lightning")
NETWORK_BYTES = 30_000_000  # of the largest network's weights
SPARE = 1.2


def check_budget(budget: Config) -> None:
    """Raises InputError where a budget's seeds are not usable."""
    seeds = budget["seeds"]
    whole = isinstance(seeds, list) and all(
        isinstance(seed, int) and not isinstance(seed, bool) and seed >= 0 for seed in seeds
    )
    if not whole or not seeds or len(set(seeds)) < len(seeds):
        raise InputError(f"budget.seeds is {seeds!r}, expected different whole numbers of at least 0, such as [0,1,2]")
    for name, variant in (budget["variants"] or {}).items():
        if variant["of"] not in ("surrogate", "inverse", "trained"):
            raise InputError(f"budget.variants.{name}.of is {variant['of']!r}, expected surrogate, inverse or trained")


def choose_true_rig(config: Config, rig: LinearRig) -> tuple[Config, str, str]:
    """The config of the judge, its name, and why the rig judges itself; the last is empty where it does not.

    Raises:
        InputError: the judge that was asked for cannot be had.
    """
    given = dict(config)
    optional = given.pop("only_if_here", False)
    if not given.get("_target_"):
        return ITSELF, rig.name, "true_rig=same was asked for"
    try:
        judge = make_true_rig(
            ClassSpec.read(given | ({"workers": 1} if "workers" in given else {}), RigBackend, "true_rig"), rig
        )
    except InputError as error:
        if not optional:
            raise
        return ITSELF, rig.name, str(error)
    return given, judge.name, ""


def find_folder(path: Path, config: Config, resume: bool) -> tuple[RunFolder, str]:
    """The folder of a reproduction, and what to say of it.

    An unfinished one may be gone on with under another config: what does not depend on the difference is kept.

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
        return RunFolder(path, config, resumed=False), f"Going on with another config than before ({reason})."


def check_capture(config: Config, rig: LinearRig) -> tuple[str | None, MeshSet | None]:
    """The hash of what the clip of a config's `capture` holds, None where none is given; and the captured data.

    Raises:
        InputError: the clip cannot be read, or is none of the rig; or a value of `reading` or `frames` is invalid.
    """
    clip_options(config)
    meshes = recording(rig, config)
    return content_key(meshes) if config["capture"] else None, meshes


def check_folder(folder: RunFolder, rig: RigInMeshSpace, budget: Config, trainings: int) -> None:
    """Begin a run's folder: see that it can be written and that its disk has room for `trainings` bundles.

    Raises:
        InputError: it cannot be written, or there is too little room.
    """
    numbers = (rig.space.size + 2 * test_samples(budget) / max(trainings, 1)) * 3 * rig.space.vertex_count
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


def code_of(rig: LinearRig, configs: list[Config]) -> tuple[str, str]:
    """Keys of all that makes figures, and of what draws them.

    The former: the code of riginv and of the rigs, the libraries, the rig as it is built, Blender.
    """
    left_out = {*MAKE_NO_FIGURES, *DRAWING}
    sources = [path for path in sorted(PACKAGE.rglob("*.py")) if not {path.stem, path.parent.name} & left_out]
    for config in configs:
        if config.get("_target_"):
            sources += sorted(Path(inspect.getfile(class_of(config["_target_"]))).parent.rglob("*.py"))
    blender = os.environ.get("RIGINV_BLENDER", "") if _version("bpy") == "-" else _version("bpy")
    drawing = [path for path in sorted(PACKAGE.rglob("*.py")) if path.stem in DRAWING]
    return f"{code_key(sources, DISTRIBUTIONS)}-{fingerprint(rig).hex()[:16]}-{blender}", code_key(drawing, ["matplotlib"])


def versions() -> dict[str, str]:
    """The versions of what made the figures."""
    names = ("riginv", *DISTRIBUTIONS, "hydra-core", "matplotlib", "jinja2", "bpy")
    return {name: _version(name) for name in names}


def check_rig(config: Config) -> None:
    """Raises InputError where a rig that is only drawn cannot be built."""
    if config.get("_target_"):
        build(config, kind=RigBackend)


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "-"
