"""Curves of a rig's controls in files: CSV, as riginv or other programs write it, or .npz."""

import zipfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from riginv.animation.text import ROTATION_COLUMNS, TRANSLATION_COLUMNS
from riginv.clips.arrays import VERTICES
from riginv.clips.csv_table import CsvTable
from riginv.clips.frame_rate import common_rate
from riginv.errors import InputError, in_short
from riginv.runs.array_files import BROKEN, DAMAGED_ZIP, check_npz
from riginv.runs.files import check_regular, read_json

FRAME, SECONDS = "frame", "seconds"
MOTION = (*TRANSLATION_COLUMNS, *ROTATION_COLUMNS)
CONTROLS, FPS, NUMBERS = "controls", "fps", "frame_numbers"  # arrays of an .npz
NAMES = ("names", "control_names")
SAME_RATE = 1e-3  # relative difference below which two rates are the same


@dataclass
class Curves:
    """Control curves as a file has them.

    Attributes:
        path: of the file.
        format: name of the file format.
        names: of the columns; None: the rig's controls in their order.
        values: `(frame, column)`; NaN where a cell is no finite number.
        frame_numbers: `(frame,)`.
        fps: frames per second; None where the file does not give it. `rate_source`: where it comes from.
        motion: rigid motion of the mesh, `(frame, 6)`: translation x, y, z in mm, rotation about x, y, z in degrees; or None.
        rig: name of the rig of the controls; None where the file does not give it.
        notes: what was repaired or left out.
        table: the CSV table and the column of each curve; None for other files.
    """

    path: Path
    format: str
    names: list[str] | None
    values: np.ndarray
    frame_numbers: np.ndarray
    fps: float | None = None
    rate_source: str = ""
    motion: np.ndarray | None = None
    rig: str | None = None
    notes: list[str] = field(default_factory=list)
    table: tuple[CsvTable, list[int]] | None = None

    def check_column(self, column: int, name: str) -> None:
        """Raise InputError where a column holds anything but finite numbers."""
        if self.table is not None:
            self.table[0].column(self.table[1][column])
        elif not np.isfinite(self.values[:, column]).all():
            row = int((~np.isfinite(self.values[:, column])).argmax())
            raise InputError(
                f"{self.path}: control '{name}' is {self.values[row, column]} in row {row}, expected a finite number"
            )


def csv_curves(table: CsvTable) -> Curves:
    """The curves of a CSV with a column for each control and optional columns `frame`, `seconds` and rigid motion.

    Raises:
        InputError: a frame, a time or the motion is no number, or a frame is no integer.
    """
    column = {name.lower(): number for number, name in enumerate(table.header)}
    frames, seconds = (table.column(column[key]) if key in column else None for key in (FRAME, SECONDS))
    has_motion = all(name in column for name in MOTION)
    known = {FRAME, SECONDS, *(MOTION if has_motion else ())}
    rest = [number for number, name in enumerate(table.header) if name and name.lower() not in known]
    names = [table.header[number].removeprefix("'") for number in rest]  # riginv writes it against spreadsheet formulas
    motion = table.columns([column[name] for name in MOTION]) if has_motion else None
    numbers = np.arange(len(table), dtype=np.float64) if frames is None else frames
    curves = Curves(table.path, "CSV of curves", names, table.numbers[:, rest], numbers, motion=motion, table=(table, rest))
    curves.notes += table.notes
    if frames is None and seconds is not None and len(table) > 1:
        curves.frame_numbers = np.round((seconds - seconds[0]) / np.median(np.diff(seconds)).clip(1e-9))
    if not (np.round(curves.frame_numbers) == curves.frame_numbers).all() or np.abs(curves.frame_numbers).max() > 2**53:
        raise InputError(f"{table.path}: column {FRAME} holds frames that are no whole numbers, which frames are counted in")
    _find_rate(curves, seconds)
    return curves


def are_curves(table: CsvTable) -> bool:
    """Whether a table has a column of frames or of seconds, as riginv writes curves."""
    return bool({FRAME, SECONDS} & {name.lower() for name in table.header})


def _find_rate(curves: Curves, seconds: np.ndarray | None) -> None:
    """Set the frame rate: from the times of the rows, or else from the .json beside the CSV; and the rig's name, from there."""
    sidecar, stated, measured = curves.path.with_suffix(".json"), None, None
    if sidecar.is_file():
        try:
            content = read_json(sidecar)
            value, rig = content.get("fps"), content.get("rig")
            curves.rig = rig if isinstance(rig, str) else None
            stated = (
                float(value) if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < 1e6 else None
            )
        except InputError as error:
            curves.notes.append(f"the file beside it was ignored: {error}")
    if seconds is not None and len(seconds) > 1 and seconds[-1] > seconds[0]:
        measured = common_rate(float((curves.frame_numbers[-1] - curves.frame_numbers[0]) / (seconds[-1] - seconds[0])))
    if stated and measured and abs(stated - measured) > SAME_RATE * stated:
        curves.notes.append(
            f"{sidecar.name} states {stated:g} frames a second, its rows have {measured:g} a second: {measured:g} was taken"
        )
        stated = None
    if stated:
        curves.fps, curves.rate_source = stated, sidecar.name
    elif measured:
        curves.fps, curves.rate_source = measured, "the seconds of its rows"


def holds_curves(path: Path) -> bool:
    """Whether an .npz holds curves and no meshes."""
    try:
        check_regular(path)
        with zipfile.ZipFile(path) as archive:
            names = {Path(name).stem for name in archive.namelist() if name.endswith(".npy")}
    except (*DAMAGED_ZIP, OSError, ValueError):
        return False  # the mesh reader reports what is wrong
    return CONTROLS in names and not names & {*VERTICES}


def npz_curves(path: Path) -> Curves:
    """The curves of an .npz: `controls (frame, control)`, optional `names` (or `control_names`), `fps`, `frame_numbers`.

    Raises:
        InputError: it is damaged, or an array is of another shape or type.
    """
    try:
        check_npz(path)
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in (CONTROLS, *NAMES, FPS, NUMBERS) if name in file}
    except InputError:
        raise
    except (*DAMAGED_ZIP, *BROKEN, OSError) as error:
        raise InputError(
            f"{path}: cannot be read ({in_short(error)}): save plain numbers and texts, names=np.array(names, dtype=str)"
        ) from None
    if CONTROLS not in arrays:
        raise InputError(f"{path}: no array '{CONTROLS}': damaged; save it again with np.savez")
    values, numbers, fps = arrays[CONTROLS], arrays.get(NUMBERS), arrays.get(FPS)
    if values.ndim != 2 or values.dtype.kind not in "fiu":
        raise InputError(f"{path}: controls are {values.dtype} of shape {values.shape}, expected numbers (frame, control)")
    if numbers is not None and (numbers.shape != values.shape[:1] or numbers.dtype.kind not in "iu"):
        raise InputError(f"{path}: frame_numbers are {numbers.dtype} of shape {numbers.shape}, expected a whole number a frame")
    if fps is not None and (fps.size != 1 or fps.dtype.kind not in "iuf"):
        raise InputError(f"{path}: fps is {fps.dtype} of shape {fps.shape}, expected one number")
    names = next((arrays[name] for name in NAMES if name in arrays), None)
    if names is not None and (names.shape != values.shape[1:] or names.dtype.kind not in "US"):
        raise InputError(
            f"{path}: names are {names.dtype} of shape {names.shape}, expected a text for each of {values.shape[1]} controls"
        )
    labels = None if names is None else [str(np.char.decode(name) if names.dtype.kind == "S" else name) for name in names]
    rows = np.arange(len(values)) if numbers is None else numbers
    rate = None if fps is None else float(fps.reshape(-1)[0])
    return Curves(path, "arrays of curves", labels, values.astype(np.float64), rows, rate, "its array fps" if rate else "")
