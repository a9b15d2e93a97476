"""python -m rigs.dna.gui: convert curves of raw controls to curves of GUI controls by the exact inverse of the table."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "gui_dna")  # before the imports that take seconds

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from omegaconf import DictConfig

from riginv.animation.table import write_rows
from riginv.config.typed import to_typed
from riginv.config.values import NonNegativeInt
from riginv.errors import InputError
from riginv.runs.console import show_result
from riginv.runs.files import free_file, read_text
from rigs.dna.format import read_dna
from rigs.dna.format.layers import Definition
from rigs.dna.inverse import TableInverse
from rigs.dna.rig import DnaRig

BATCH_SIZE = 64  # frames at a time
DIGITS = 9


@dataclass(frozen=True)
class GuiConfig:
    """The config of `rigs.dna.gui`; conf/gui_dna.yaml explains each key."""

    file: str
    curves: str
    out: str
    lod: NonNegativeInt


def gui(config: DictConfig) -> None:
    """Write the GUI controls for the raw controls of `config.curves`, and print the vertex distance."""
    settings = to_typed(config, GuiConfig)
    source, out = Path(settings.curves), free_file(settings.out, ".csv")
    file = read_dna(settings.file)
    definition = file.need(Definition)
    rig = DnaRig(settings.file, "raw", settings.lod)
    columns, rows = read_columns(source)
    raw = np.repeat(rig.neutral_controls.double().numpy()[None], len(rows), axis=0)
    index_of = {name: number for number, name in enumerate(definition.raw_controls)}
    found = [(number, index_of[name]) for number, name in enumerate(columns) if name in index_of]
    if not found:
        raise InputError(
            f"{source}: no column is named as a raw control of {file.path}, such as '{definition.raw_controls[0][:60]}'"
        )
    for number, control in found:
        raw[:, control] = [_number(source, line, columns[number], row[number]) for line, row in enumerate(rows, start=2)]
    answer = TableInverse(file)(raw)
    kept = [number for number, name in enumerate(columns) if name not in index_of]
    quaternions = [(number, control) for number, control in found if control in rig.model.logic.quaternions]
    kept += [number for number, _ in quaternions]
    body = [[*(row[number] for number in kept), *values] for row, values in zip(rows, answer.gui.round(DIGITS).tolist())]
    write_rows(out, [*(columns[number] for number in kept), *definition.gui_controls], body)
    mean, worst = _distances(rig, raw, answer.residual)
    show_result(
        f"{out}: {len(rows)} frames of {len(definition.gui_controls)} GUI controls; raw controls are met to "
        f"{np.abs(answer.residual).max(initial=0.0):.2g} at most, vertices to {mean:.2g} mm on average, {worst:.2g} mm at most"
    )


def read_columns(path: Path) -> tuple[list[str], list[list[str]]]:
    """Column names and rows of a table, such as a `curves.csv` of riginv.invert.

    Raises:
        InputError: it cannot be read, or a row has a different number of columns.
    """
    try:
        columns, *rows = [row for row in csv.reader(io.StringIO(read_text(path))) if row]
    except (csv.Error, ValueError) as error:
        raise InputError(f"{path}: no table of comma-separated values ({error}): give the curves.csv of an inversion") from None
    for line, row in enumerate(rows, start=2):
        if len(row) != len(columns):
            raise InputError(f"{path}: row {line} has {len(row)} values, expected {len(columns)}: the file is truncated")
    return [column.removeprefix("'") for column in columns], rows


def _number(path: Path, line: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{path}: row {line}, column '{name[:60]}' holds {cell[:40]!r}, expected a number")
    return value


@torch.no_grad()
def _distances(rig: DnaRig, raw: np.ndarray, residual: np.ndarray) -> tuple[float, float]:
    """Mean and greatest vertex distance, mm, between given raw controls and those of the table."""
    quaternions = rig.model.logic.quaternions.reshape(-1)
    reached = np.clip(raw, 0, 1) + residual
    reached[:, quaternions] = raw[:, quaternions]
    pairs = zip(torch.tensor(raw).float().split(BATCH_SIZE), torch.tensor(reached).float().split(BATCH_SIZE))
    found = [(rig(given) - rig(other)).norm(dim=2) for given, other in pairs]
    distances = torch.cat(found) if found else torch.zeros(1)
    return float(distances.mean()), float(distances.max())


if __name__ == "__main__":
    command("gui_dna")(gui)()
