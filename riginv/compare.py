"""python -m riginv.compare: compare methods of rig inversion on the same meshes, with errors on the true rig."""

from riginv.launch.command import answer_help, command, run_directory

answer_help(__name__, "compare")  # before the imports that take seconds

import time
from dataclasses import dataclass

import torch
from omegaconf import DictConfig

from riginv.clips.description_text import show_clip
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.config.aliases import upgraded
from riginv.config.building import ClassSpec
from riginv.config.typed import MeshSpaceConfig, to_typed
from riginv.config.values import NonNegativeInt, PositiveInt
from riginv.errors import InputError
from riginv.evaluation.evaluation_sets import random_sets
from riginv.evaluation.optimum import find_optima
from riginv.methods.base import Method, suited_methods
from riginv.methods.comparison import ComparisonProgress, keep_rows, kept_rows, show, write_tables
from riginv.methods.evaluation import evaluated_row
from riginv.rig.control_effects import ControlEffects
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.runs.run_folder import find_run_folder, plain_config
from riginv.tracking.rigs import build_clip, build_rig, build_true_rig


@dataclass(frozen=True)
class CompareConfig:
    """The config of `riginv.compare`; conf/compare.yaml explains each key."""

    rig: ClassSpec[RigBackend]
    true_rig: ClassSpec[RigBackend] | None
    reading: ReadingOptions
    frames: FrameOptions
    seed: NonNegativeInt
    capture: str | None
    poses: PositiveInt
    mesh_space: MeshSpaceConfig
    methods: dict[str, ClassSpec[Method]] | None = None  # methods=[] leaves the key out
    resume: bool = False


def compare(config: DictConfig) -> None:
    """Run every method on every set; print a table, and write `compare.csv`, `compare.md` and `compare.png`.

    Each finished method is kept in the folder at once: an interrupted comparison, or one with further methods, continues
    from there with `resume=true`.
    """
    settings = to_typed(config, CompareConfig)
    record = {key: value for key, value in plain_config(config).items() if key != "methods"}  # others may join in later
    folder = find_run_folder(run_directory(), record, settings.resume, upgrade=upgraded)
    rig = build_rig(settings.rig, settings.mesh_space)
    true_rig = build_true_rig(settings.true_rig, rig)
    if true_rig.held_out is not None:
        raise InputError(
            f"rig '{true_rig.name}' is a table of recorded poses; compare needs a rig that can be posed, to compute errors"
        )
    specs = settings.methods or {}
    methods, left_out = suited_methods(specs, RigInMeshSpace(rig, MeshSpace.from_rig(rig)))
    clip = build_clip(settings.capture, settings.reading, settings.frames, rig, true_rig, settings.poses)
    show_clip(clip)
    sets = [*random_sets(true_rig, settings.poses), *([clip] if clip else [])]
    folder.begin()
    with ComparisonProgress(len(methods)) as progress:
        progress.at("the optimum", "many starts on a few meshes of each set")
        optima, effects = find_optima(true_rig, sets, rig), ControlEffects.of_rig(true_rig)
        for name, method in methods.items():
            facts = {"config": specs[name].config, "fingerprint": method.fingerprint}
            rows = kept_rows(folder.path, name, facts)
            if rows is None:
                progress.at(name, "preparing")
                seconds, rows = prepare(method, settings.seed), []
                for meshes in sets:
                    progress.at(name, meshes.name.replace("_", " "))
                    row = evaluated_row(name, method, true_rig, meshes, seconds, optima.get(meshes.name), effects)
                    rows.append(row.as_dict())
                keep_rows(folder.path, name, {**facts, "source": method.source}, rows)
            progress.finished(name, rows)
    show(write_tables(folder.path), folder.path, left_out)


def prepare(method: Method, seed: int) -> float:
    """Prepare a method, which trains, fits or tabulates what it needs; returns the seconds that all its training took."""
    torch.manual_seed(seed)
    began = time.perf_counter()
    method.prepare(seed)
    return method.trained_seconds + time.perf_counter() - began


if __name__ == "__main__":
    command("compare")(compare)()
