"""python -m rigs.dna.evaluate: every stage of a DNA file for given controls, under the keys of docs/dna.md.

For comparison with an engine: everything is in the file's units, axes and rotation sequence.
"""

from riginv.launch.command import answer_help, command

answer_help(__name__, "evaluate_dna")  # before the imports that take seconds

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig
from torch import Tensor

from riginv.config.typed import to_typed
from riginv.config.values import NonNegativeInt
from riginv.errors import InputError, in_short
from riginv.runs.array_files import check_npz
from riginv.runs.console import show_lines, show_result
from riginv.runs.files import atomic_write, free_file
from rigs.dna.format import DnaFile, read_dna
from rigs.dna.format.layers import Definition
from rigs.dna.geometry.space import Space
from rigs.dna.inverse import TableInverse
from rigs.dna.logic.stages import Logic, Stages
from rigs.dna.model import Model

Arrays = dict[str, np.ndarray]
BATCH_SIZE = 256  # rows at a time


@dataclass(frozen=True)
class EvaluateConfig:
    """The config of `rigs.dna.evaluate`; conf/evaluate_dna.yaml explains each key."""

    file: str
    inputs: str
    out: str
    lod1_rows: NonNegativeInt
    quaternion_rows: tuple[NonNegativeInt, NonNegativeInt]
    vertex_rows: tuple[NonNegativeInt, NonNegativeInt]


def evaluate(config: DictConfig) -> None:
    """Evaluate `config.file` for `config.inputs`, and write `config.out`."""
    settings = to_typed(config, EvaluateConfig)
    out = free_file(settings.out, ".npz")
    file = read_dna(settings.file)
    given = read_inputs(Path(settings.inputs), file)
    with torch.no_grad():
        found: dict[str, Any] = dict(all_stages(file, given, settings))
    with atomic_write(out) as partial, partial.open("wb") as target:
        np.savez_compressed(target, **found)
    rows = ", ".join(f"{len(given[name])} rows of {name}" for name in ("gui", "raw") if name in given)
    show_result(f"{out}: {rows}; {len(found)} arrays")


def read_inputs(path: Path, file: DnaFile) -> Arrays:
    """The arrays `raw` and `gui`, and the rows to compute vertices for.

    Raises:
        InputError: both are missing, or they do not match the controls of the file.
    """
    check_npz(path)
    definition = file.need(Definition)
    names = {"raw": len(definition.raw_controls), "gui": len(definition.gui_controls)}
    try:
        with np.load(path, allow_pickle=False) as table:
            found = {name: table[name] for name in (*names, "raw_vertex_rows", "lod1_vertex_rows") if name in table.files}
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: cannot be read as arrays: {in_short(error)}") from None
    if not set(found) & set(names):
        raise InputError(f"{path}: neither raw nor gui in it, expected controls (row, control) under these names")
    for name, count in names.items():
        if name in found and (found[name].ndim != 2 or found[name].shape[1] != count or found[name].dtype.kind not in "fiu"):
            raise InputError(
                f"{path}: {name} is {found[name].dtype} of shape {found[name].shape}, expected numbers of shape "
                f"(row, {count}), the {name} controls of {file.path}"
            )
        if name in found and not (len(found[name]) and np.isfinite(found[name]).all()):
            raise InputError(f"{path}: {name} has no rows, or values that are not finite, expected numbers in every row")
    return found


def all_stages(file: DnaFile, given: Arrays, settings: EvaluateConfig) -> Arrays:
    """Every stage of the file for given controls, by key, float32."""
    stages: Arrays = {}
    logic = _reference(Logic(file))
    joints = bool(file.need(Definition).joints)
    if "gui" in given:
        gui = torch.tensor(given["gui"].astype(np.float32))
        raw = logic.raw_of(gui)  # in float32, as engines do
        stages["gui_raw"] = raw.numpy()
        if not len(logic.quaternions):  # the table sets quaternions to 0, where joints have no rotation
            stages |= {f"gui_{key}": value for key, value in _stages(logic, raw.double(), 0, joints).items()}
    if "raw" in given:
        raw = torch.tensor(given["raw"]).double()
        answer = TableInverse(file)(raw.numpy())
        stages |= {"raw_gui": answer.gui, "raw_gui_residual": answer.residual}
        levels = [("raw", 0, raw), ("lod1", 1, raw[: settings.lod1_rows])]
        for key, lod, rows in levels[: max(1, logic.layout.lod_count)]:
            level = logic if lod == 0 else _reference(Logic(file, lod))
            level_stages = _stages(level, rows, settings.quaternion_rows[lod], joints)
            stages |= {f"{key}_{name}": value for name, value in level_stages.items()}
            try:
                stages |= _vertices(file, lod, key, rows, given, settings.vertex_rows[lod])
            except InputError as error:
                show_lines([f"no vertices at level of detail {lod}: {error}"])
    return {
        name: value.astype(np.float32) if value.dtype.kind == "f" else value for name, value in stages.items() if value.size
    }


def _reference(logic: Logic) -> Logic:
    """The logic with the rounding of the reference also for float64 controls."""
    if logic.radial is not None:
        logic.radial.round_as_reference()
    return logic


def _stages(logic: Logic, raw: Tensor, quaternion_rows: int, joints: bool) -> Arrays:
    """The stages that follow raw controls, by name."""
    layout, batches = logic.layout, [logic(batch) for batch in raw.split(BATCH_SIZE)]

    def joined(select: Callable[[Stages], Tensor]) -> np.ndarray:
        return torch.cat([select(batch) for batch in batches]).numpy() if batches else np.zeros(0)

    controls = joined(lambda stages: stages.controls)
    found = {"ml": controls[:, layout.mls], "rbf": controls[:, layout.rbfs], "psd": controls[:, layout.psds]}
    if not np.array_equal(controls[:, : layout.raw], raw.numpy()):
        found["after"] = controls[:, : layout.raw]
    if logic.psds.chained:
        found["psd_second_call"] = _second_call(logic, raw, batches)
    found["channels"] = joined(lambda stages: stages.channels)
    found["maps"] = joined(lambda stages: stages.maps)
    if joints:
        found["joints"] = joined(lambda stages: logic.joints.as_euler(stages.joints))
        if quaternion_rows:
            quaternions = joined(lambda stages: logic.joints.as_quaternions(stages.joints))
            found["joints_quaternion"] = quaternions[:quaternion_rows]
    return found


def _second_call(logic: Logic, raw: Tensor, batches: list[Stages]) -> np.ndarray:
    """PSDs of a second evaluation, in which those that depend on PSDs use the values of the first."""
    psds = logic.layout.psds
    before = torch.cat([stages.controls[:, psds] for stages in batches])
    return logic.all_controls(raw, before)[:, psds].numpy()


def _vertices(file: DnaFile, lod: int, key: str, raw: Tensor, given: Arrays, count: int) -> Arrays:
    """World transforms of joints, and vertices, of some rows, in the file's units and axes."""
    model = Model(file, lod, unit_mm=Space.of(file).unit_mm, all_joints=True)
    _reference(model.logic)
    rows = given.get(f"{key}_vertex_rows", np.arange(min(count, len(raw)))).astype(np.int64)
    rows = rows[(rows >= 0) & (rows < len(raw))]
    raw = raw[torch.tensor(rows)]
    found: Arrays = {f"{key}_vertex_rows": rows}
    skeleton, stage, space = model.skeleton, model.logic.joints, model.space
    if len(model.joints):
        worlds = skeleton.worlds(stage, stage(model.logic.all_controls(raw)))
        found[f"{key}_world"] = space.transforms_in_file(worlds.movedim(-1, 0).numpy(), model.centre.numpy())
        if lod == 0:
            found["neutral_world"] = space.transforms_in_file(skeleton.neutral.numpy(), model.centre.numpy())
            found |= {f"neutral{ending}": values for ending, values in skeleton.neutral_values(file, stage.angles).items()}
    vertices = space.points_in_file(model(raw).numpy())
    definition = file.need(Definition)
    for name, start, end in zip(model.surface.names, model.surface.starts, model.surface.starts[1:]):
        found[f"{key}_vertices_mesh{definition.meshes.index(name)}"] = vertices[:, start:end]
    return found


if __name__ == "__main__":
    command("evaluate_dna")(evaluate)()
