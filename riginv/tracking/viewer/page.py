"""The result of an inversion as a self-contained HTML page: target and recovered meshes, errors, curves, flagged frames."""

import base64
import gzip
import html
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.animation.animation import Animation, FrameErrors
from riginv.errors import counted
from riginv.meshes.rendering import HEAT_STOPS
from riginv.runs.files import write_text
from riginv.tracking.viewer.scans import MAX_SCANS, Scans, drawn, scan_bytes
from riginv.tracking.viewer.thinning import Thinned, thin

Targets = Callable[[Sequence[int]], Tensor]  # rows of the animation to target meshes (row, vertex, 3), mm

HERE = Path(__file__).parent
SLOT = re.compile(r"/\*(TITLE|STYLE|SCRIPT|FACTS|MESHES|VALUES|FACES|COLORS|SCANS)\*/")
MAX_VERTICES = 20_000
MAX_NUMBERS = 18_000_000  # of all meshes together: about 20 MB of file
MAX_FRAMES = 1200
WORST = 20  # frames in the list
STEP_MM = 0.02  # quantisation of positions, finer for small meshes
LARGEST = 32_000  # of the quantised integers
UNKNOWN = -32_768
FIGURES = {  # key of FrameErrors.summary: label in the page's head
    "mean_error_mm": "mm mean error",
    "neutral_mean_error_mm": "mm at neutral",
    "least_mean_error_mm": "mm at least, on {frames} frames",
    "max_error_mm": "mm worst vertex",
}
SCAN_FIGURES = {"mean_error_mm": "mm from scan to rig", "max_error_mm": "mm from rig to scan, the farthest"}
LABELS = ("mean", "max", "mean error", "maximum error", "Target")  # of a frame's two errors, in short and in full; of the clip
SCAN_LABELS = ("scan to rig", "rig to scan", "scan to rig", "rig to scan", "Scan")
BATCH_SIZE = 64  # meshes
LEVEL = 4  # of compression: 6 takes two and a half times as long for 3 % fewer bytes


class ClipSource(NamedTuple):
    """The description of the clip in words.

    Attributes:
        line: a summary.
        rows: labels and values.
        warnings: sentences about implausible values.
        notes: sentences about what was guessed or repaired.
    """

    line: str
    rows: Sequence[tuple[str, str]]
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class PageContents:
    """The contents of a page.

    Attributes:
        frames: number of meshes, of `all_frames`; the page interpolates between them. All curves and errors are included.
        vertices: number of vertices, of `all_vertices`.
        note: the same in words, and the precision of positions.
    """

    frames: int
    all_frames: int
    vertices: int
    all_vertices: int
    note: str


def write_viewer(
    path: Path,
    animation: Animation,
    errors: FrameErrors,
    targets: Targets,
    advance: Callable[[int], None] | None = None,
    clip: ClipSource | None = None,
    scans: Scans | None = None,
) -> PageContents:
    """Write the page.

    Args:
        targets: target meshes by rows of the animation, without rigid motion; NaN where a vertex is not known.
        advance: reports the number of meshes added.
        clip: description of the clip.
        scans: drawn in place of the target meshes, which are then the nearest points of each scan.

    Returns:
        the contents; long clips are reduced to fewer meshes, large meshes to fewer vertices.
    """
    rig = animation.rig
    thinned = thin(rig.rest_vertices.cpu().numpy(), rig.faces.cpu().numpy(), MAX_VERTICES)
    most = min(MAX_FRAMES if scans is None else MAX_SCANS, max(2, MAX_NUMBERS // (6 * len(thinned.kept))))
    rows = shown_rows(animation, errors, most)
    skin = thinned.kept < (len(rig.rest_vertices) if scans is None else scans.skin)
    meshes, top_mm = _meshes(animation, targets, rows, thinned, skin, advance)
    middle = (np.nanmax(meshes, axis=(0, 1, 2)) + np.nanmin(meshes, axis=(0, 1, 2))) / 2
    meshes -= middle
    scanned = [] if scans is None else drawn(scans, rows)
    extents = [np.abs(scan.points - middle).max(initial=0) for scan in scanned]
    farthest = float(max([np.nanmax(np.abs(meshes)), *extents]))
    step = max(farthest / LARGEST, min(STEP_MM, farthest / 4000))
    integers = np.where(np.isnan(meshes), UNKNOWN, np.round(np.nan_to_num(meshes) / step)).astype(np.int16)
    count, vertex_count = len(animation), len(thinned.kept)
    note = _note(len(rows), count, vertex_count, len(rig.rest_vertices), step)
    colors = rig.vertex_colors()
    lower, span = rig.lower.cpu().double(), (rig.upper - rig.lower).cpu().double()
    values = ((animation.controls.cpu().double() - lower) / span * 65534 - 32767).round().clamp(-32767, 32767)
    counts, packed_scans = scan_bytes(scanned, middle, step)
    facts = {
        **_facts(animation, errors, scans is not None),
        "shown": rows,
        "vertices": vertex_count,
        "step": step,
        "radius": float(np.nanmax(np.linalg.norm(meshes, axis=-1))),
        "top_mm": top_mm,
        "heat": (HEAT_STOPS * 255).round().astype(int).tolist(),
        "colored": colors is not None,
        "note": note,
        "clip": clip._asdict() if clip else None,
        "scans": counts,
    }
    parts = {
        "TITLE": html.escape(facts["source"]),
        "STYLE": (HERE / "page.css").read_text(encoding="utf-8"),
        "SCRIPT": (HERE / "scene.js").read_text(encoding="utf-8") + (HERE / "page.js").read_text(encoding="utf-8"),
        "FACTS": json.dumps(facts, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        "MESHES": _packed(_changes(integers.reshape(len(rows), -1))),
        "VALUES": _packed(_changes(values.numpy().astype(np.int16))),
        "FACES": _packed(thinned.faces.astype("<u4").tobytes()),
        "SCANS": _packed(packed_scans),
        "COLORS": _packed(b"" if colors is None else _bytes(colors.cpu().numpy()[thinned.kept])),
    }
    page = (HERE / "page.html").read_text(encoding="utf-8")
    page = SLOT.sub(lambda slot: parts[slot[1]], page)  # in one pass, so that inserted text is not searched
    write_text(path, page)
    return PageContents(len(rows), count, vertex_count, len(rig.rest_vertices), note)


def shown_rows(animation: Animation, errors: FrameErrors, limit: int) -> list[int]:
    """Rows whose meshes are shown: all, or evenly spread ones, the worst ones and flagged ones."""
    count = len(animation)
    if count <= limit:
        return list(range(count))
    rows = evaluated_rows(animation, errors)
    wanted = [row for each in [*errors.worst(WORST), *errors.flagged] if (row := rows[each]) is not None]
    kept = set(wanted[: limit // 4])
    spread = np.linspace(0, count - 1, limit - len(kept)).round().astype(int).tolist()
    return sorted(kept | set(spread))


@torch.no_grad()
def _meshes(
    animation: Animation,
    targets: Targets,
    rows: list[int],
    thinned: Thinned,
    skin: np.ndarray,
    advance: Callable[[int], None] | None,
) -> tuple[np.ndarray, float]:
    """Target and recovered meshes `(frame, 2, vertex, 3)`, mm, and the error of `skin` `(vertex,)` that is drawn red."""
    both = np.empty((len(rows), 2, len(thinned.kept), 3), np.float32)
    kept = torch.tensor(thinned.kept)
    for start in range(0, len(rows), BATCH_SIZE):
        some = rows[start : start + BATCH_SIZE]
        recovered = animation.rig(animation.controls[some])
        wanted = targets(some).to(recovered)
        both[start : start + len(some), 0] = wanted[:, kept].cpu().numpy()
        both[start : start + len(some), 1] = recovered[:, kept].cpu().numpy()
        if advance:
            advance(len(some))
    distance = np.linalg.norm(both[:, 0] - both[:, 1], axis=-1)[:, skin]
    known = distance[~np.isnan(distance)]
    top = float(np.quantile(known, 0.995)) if len(known) else 0.0
    return both, max(float(f"{top:.2g}"), 1e-3)


def evaluated_rows(animation: Animation, errors: FrameErrors) -> list[int | None]:
    """The row in the animation of each evaluated frame; None where it has none."""
    if errors.frame_numbers is None:
        return list(range(len(animation)))
    row_of = {number: row for row, number in enumerate(animation.frame_numbers.tolist())}
    return [row_of.get(number) for number in errors.frame_numbers.tolist()]


def _facts(animation: Animation, errors: FrameErrors, of_scans: bool) -> dict[str, Any]:
    """The texts and numbers of the page."""
    rig = animation.rig
    made_by = [str(animation.made_by[key]) for key in ("method",) if key in animation.made_by]
    about = [
        f"rig {rig.name}",
        *made_by,
        f"{counted(len(animation), 'frame')} at {animation.fps:g} fps",
        f"{len(rig.controls)} controls",
    ]
    if animation.keys is not None:
        about.append(f"{sum(map(len, animation.keys)):,} keys")
    axes = (errors.mean_mm.double(), errors.max_mm.double())
    return {
        "source": animation.source or rig.name,
        "about": " · ".join(about),
        "figures": _figures(errors, SCAN_FIGURES if of_scans else FIGURES),
        "labels": SCAN_LABELS if of_scans else LABELS,
        "fps": animation.fps,
        "numbers": animation.frame_numbers.tolist(),
        "axis_mm": [_rounded(float(values.nan_to_num().quantile(0.999))) for values in axes],
        "controls": [{"name": c.name, "lower": c.lower, "upper": c.upper, "unit": c.unit} for c in rig.controls],
        "errors": _frame_facts(animation, errors),
    }


def _figures(errors: FrameErrors, named: Mapping[str, str]) -> list[list[str]]:
    """The figures in the page's head: label and number."""
    values, frames = errors.summary(), 0 if errors.optimum is None else len(errors.optimum.rows)
    shown = [[name.format(frames=frames), f"{values[key]:.3g}"] for key, name in named.items() if key in values]
    accuracy = {"control_precision": "precision of controls", "control_recall": "recall of controls"}
    shown += [[name, f"{errors.controls[key]:.3f}"] for key, name in accuracy.items() if key in errors.controls]
    return [*shown, ["frames with a flag", f"{len(errors.flagged):,}"]]


def _frame_facts(animation: Animation, errors: FrameErrors) -> dict[str, Any]:
    """The errors at each row of the animation; after resampling those of the nearest evaluated frame."""
    nearest = np.linspace(0, len(errors.mean_mm) - 1, len(animation)).round().astype(int)
    back = {int(index): row for row, index in reversed(list(enumerate(nearest.tolist())))}
    return {
        "mean": [_rounded(value) for value in errors.mean_mm[nearest].tolist()],
        "max": [_rounded(value) for value in errors.max_mm[nearest].tolist()],
        "vertex": errors.worst_vertex[nearest].tolist(),
        "region": [errors.worst_region[row] for row in nearest],
        "flags": [errors.flags[row] for row in nearest],
        "worst": [back[row] for row in errors.worst(WORST) if row in back],
    }


def in_mm(value: float) -> str:
    """An error as text, without its unit."""
    return "<0.001" if 0 < value < 0.001 else f"{value:.3g}"


def _rounded(value: float) -> float:
    """A number with three digits; NaN becomes 0."""
    return float(f"{value:.3g}") if np.isfinite(value) else 0.0


def _note(frames: int, all_frames: int, vertices: int, all_vertices: int, step: float) -> str:
    parts = [f"positions rounded to {step / 2:.2g} mm"]
    if vertices < all_vertices:
        parts.insert(0, f"{vertices:,} of {all_vertices:,} vertices")
    if frames < all_frames:
        parts.insert(0, f"meshes of {frames:,} of {all_frames:,} frames, all curves and errors")
    return ", ".join(parts)


def _changes(rows: np.ndarray) -> bytes:
    """Integers `(row, number)` as differences between rows: all low bytes, then all high bytes."""
    changes = np.diff(rows, axis=0, prepend=np.zeros_like(rows[:1])).astype("<i2")  # wraps around, and back when summed
    planes = changes.reshape(-1).view(np.uint8).reshape(-1, 2)
    return np.ascontiguousarray(planes.T).tobytes()


def _packed(data: bytes) -> str:
    return base64.b64encode(gzip.compress(data, LEVEL, mtime=0)).decode()


def _bytes(colors: np.ndarray) -> bytes:
    return (np.clip(colors, 0, 1) * 255).round().astype(np.uint8).tobytes()
