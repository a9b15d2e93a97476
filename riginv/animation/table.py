"""curves.csv, curves.json and frames.csv, from which every other format can be made."""

import csv
import io
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from riginv.animation.animation import Animation, FrameErrors
from riginv.animation.text import ROTATION_COLUMNS, TRANSLATION_COLUMNS, digits, rigid_motion_columns
from riginv.runs.files import write_json, write_text

CURVES, SIDECAR, FRAMES = "curves.csv", "curves.json", "frames.csv"
FORMULA, NUMBER = ("=", "+", "-", "@", "\t", "\r"), re.compile(r"[+-]?[\d.]+(e[+-]?\d+)?|[+-]?(inf|nan)")
SPACE = "millimetres, y up; motion turns about x, then y, then z (axes that stay)"


def write_curves(path: Path, animation: Animation) -> None:
    """Write a row for each frame: number, time, controls, and rigid motion if it was removed."""
    columns = ["frame", "seconds", *animation.rig.control_names]
    values = animation.controls.detach().cpu().double().numpy()
    motion = rigid_motion_columns(animation)
    if motion is not None:
        columns += [*TRANSLATION_COLUMNS, *ROTATION_COLUMNS]
        values = np.concatenate([values, motion], axis=1)
    line = ",".join(["%d", "%.6f", *["%.7g"] * values.shape[1]]) + "\n"  # as `digits`; faster than cell by cell
    rows = zip(animation.frame_numbers.tolist(), animation.seconds.tolist(), (values + 0.0).tolist())
    lines = [line % (number, seconds, *row) for number, seconds, row in rows]
    write_text(path, safe_csv(columns, []) + "".join(lines))


def write_sidecar(path: Path, animation: Animation, errors: FrameErrors, clip: Mapping[str, Any] | None = None) -> None:
    """Write the meaning of the columns of curves.csv, the errors, and the description of the clip."""
    numbers = animation.frame_numbers.tolist()
    content: dict[str, Any] = {
        "source": animation.source,
        "fps": animation.fps,
        "frames": {"first": numbers[0], "last": numbers[-1], "count": len(numbers)},
        "rig": animation.rig.name,
        "space": SPACE,
        "controls": [vars(control) for control in animation.rig.controls],
        "made_by": animation.made_by,
        "errors": {key: round(value, 6) for key, value in errors.summary().items() if math.isfinite(value)},
    }
    if errors.optimum is not None:
        evaluated = animation.frame_numbers if errors.frame_numbers is None else errors.frame_numbers
        content["errors"]["least_error_frames"] = evaluated[errors.optimum.rows].tolist()
    if errors.markers:
        content["markers"] = [
            {key: value if isinstance(value, str) else in_json(value) for key, value in marker._asdict().items()}
            for marker in errors.markers
        ]
    if errors.controls:
        content["control_accuracy"] = errors.controls
    if clip is not None:
        content["clip"] = clip
    if animation.motion is not None:
        content["motion"] = [*TRANSLATION_COLUMNS, *ROTATION_COLUMNS]
    if animation.keys is not None:
        names, keys = animation.rig.control_names, animation.keys
        content["keys"] = {name: animation.frame_numbers[rows].tolist() for name, rows in zip(names, keys)}
    write_json(path, content)


def in_json(value: float) -> float | None:
    """A number for JSON, which has no NaN."""
    return round(value, 6) if math.isfinite(value) else None


def write_frames(path: Path, animation: Animation, errors: FrameErrors) -> None:
    """Write a row for each evaluated frame."""
    numbers = animation.frame_numbers if errors.frame_numbers is None else errors.frame_numbers
    columns = ["frame", "mean_error_mm", "max_error_mm", "worst_vertex", "worst_region", "flags"]
    columns += ["neutral_error_mm", "least_error_mm"]
    least: list[str] = [""] * len(numbers)
    if errors.optimum is not None:
        for row, (value,) in zip(errors.optimum.rows.tolist(), digits(errors.optimum.least_mm[:, None].cpu().numpy())):
            least[row] = value
    neutral = [[""]] * len(numbers) if errors.neutral_mm is None else digits(errors.neutral_mm[:, None].cpu().numpy())
    rows = zip(
        numbers.tolist(),
        digits(errors.mean_mm[:, None].cpu().numpy()),
        digits(errors.max_mm[:, None].cpu().numpy()),
        errors.worst_vertex.tolist(),
        errors.worst_region,
        errors.flags,
        neutral,
        least,
    )
    body = [
        [number, *mean, *most, vertex, region, ";".join(flags), *rest, low]
        for number, mean, most, vertex, region, flags, rest, low in rows
    ]
    write_rows(path, columns, body)


def as_text(cell: str) -> str:
    """A cell that no spreadsheet evaluates as a formula: an apostrophe is put before what would be one.

    Source: OWASP, CSV Injection. Numbers stay as they are.
    """
    return f"'{cell}" if cell[:1] in FORMULA and not NUMBER.fullmatch(cell) else cell


def write_rows(path: Path, columns: list[str], rows: list[list[Any]]) -> None:
    """Write a CSV atomically."""
    write_text(path, safe_csv(columns, rows))


def safe_csv(columns: list[str], rows: list[list[Any]]) -> str:
    """A CSV as text, whose cells no spreadsheet evaluates as formulas."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([as_text(column) for column in columns])
    writer.writerows([as_text(value) if isinstance(value, str) else value for value in row] for row in rows)
    return text.getvalue()
