"""The terminal output of riginv.invert: notes, a progress bar, and a table of errors."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import roma
import torch
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor

from riginv.animation.animation import Animation, FrameErrors
from riginv.errors import counted
from riginv.rig.interface import RigBackend
from riginv.runs.console import Bar
from riginv.runs.tables import control_lines, new_table
from riginv.tracking.regions import STILL
from riginv.tracking.results import PAGE

LISTED_FRAMES = 5
FLAG_MEANINGS = {
    "outside_training_range": "the mesh is unlike those that the network was trained on",
    "outside_reach": "the rig cannot make this mesh",
    "not_converged": "more solver steps would lower the error (refine=N, solver.steps)",
    "lost": "the scan does not lie on the rig's surface",
    "unexplained": "part of the scan is nowhere near the rig's surface",
    "little_seen": "the scan has seen little of the rig",
    "far_landmarks": "a landmark lies more than 10 mm from where the rig has it",
    "ambiguous": "scan and prior together leave the mesh unsure",
    "few_markers": "fewer than half of the markers were observed",
    "no_markers": "fewer than 4 markers were observed, or the frame was excluded: interpolated",
    "swapped_labels": "markers carried each other's labels, which were exchanged back",
    "stray_markers": "markers lie where the rig has none, and were left out",
    "no_scan": "no scan of 50 points or more, or the frame was excluded",
    "missing_vertices": "some vertices are not known, or the frame was excluded",
}


class InversionProgress(Bar):
    """A context manager that prints notes, then shows the progress of each pass, if there is a terminal.

    Args:
        frames: number of frames of each pass.
        notes: what was guessed.
    """

    def __init__(self, frames: int, notes: Sequence[str]) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(24),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        self.frames = frames
        self.passes: dict[str, TaskID] = {}
        for note in notes:
            self.console.print(f"note: {note}", highlight=False, soft_wrap=True, markup=False)

    def advance(self, what: str, frames: int) -> None:
        """Advance a pass by some frames; 0: it has begun, and its progress is not known."""
        if what not in self.passes:
            self.passes[what] = self.bar.add_task(what, total=self.frames if frames else None)
        self.bar.advance(self.passes[what], frames)


def show(
    animation: Animation,
    errors: FrameErrors,
    true_rig: RigBackend,
    folder: Path,
    files: Sequence[str],
    notes: Sequence[str],
    measure: str = "vertex errors",
    rows: Sequence[str] = ("mean vertex error", "maximum vertex error"),
) -> None:
    """Print the errors of the frames, which frames to look at, and what was written."""
    console = Console()
    known = ~errors.mean_mm.isnan()
    title = f"{animation.source}: {counted(len(animation), 'frame')} at {animation.fps:g} a second, {measure} in mm"
    table = new_table(("", "mean", "median", "95th percentile", "maximum"), title, padding=2)
    for name, values in zip(rows, (errors.mean_mm, errors.max_mm)):
        table.add_row(name, *_figures(values[known]))
    if errors.neutral_mm is not None:
        table.add_row("neutral pose", *_figures(errors.neutral_mm[known]))
    console.print(table)
    worst = ", ".join(_frame(animation, errors, row) for row in _worst(animation, errors, known))
    console.print(
        f"  Evaluated by the true rig, [bold]{escape(true_rig.name)}[/]. Worst frames: {escape(worst)}",
        highlight=False,
        soft_wrap=True,
    )
    if errors.optimum is not None:
        console.print(f"  {_optimum(errors, len(errors.optimum.rows))}", highlight=False, soft_wrap=True)
    for line in control_lines(errors.controls):
        console.print(f"  {line}", highlight=False, soft_wrap=True, markup=False)
    if animation.motion is not None:
        console.print(f"  Rigid motion was removed: {_extent(animation.motion)}.", highlight=False, soft_wrap=True)
    counts = Counter(flag for flags in errors.flags for flag in flags)
    for flag, count in counts.most_common():
        console.print(f"  [yellow]{flag}[/]: {counted(count, 'frame')}: {FLAG_MEANINGS[flag]}", highlight=False, soft_wrap=True)
    if not counts:
        console.print("  No frame is flagged.", highlight=False)
    next_step = f"; open {folder / PAGE} in a browser" if PAGE in files else ""
    for note in notes:
        console.print(f"  {note}", highlight=False, soft_wrap=True, markup=False)
    console.print(f"  {folder}: {', '.join(files)}{next_step}", highlight=False, soft_wrap=True, markup=False)


def _optimum(errors: FrameErrors, count: int) -> str:
    """The lowest possible errors on some frames, and the errors there."""
    values = errors.summary()
    found, least = values["mean_error_there_mm"], values["least_mean_error_mm"]
    frames = f"{count} frames spread over the clip" if count > 1 else "one frame"
    by, most = ("solver in a fitted basis", "at most ") if "least_error_is_bound" in values else ("many-start solver", "")
    return f"Lowest possible mean error on {frames} ({by}): {most}{least:.3g} mm; these curves: {found:.3g} mm there."


def _worst(animation: Animation, errors: FrameErrors, known: Tensor) -> list[int]:
    """Rows of the worst frames, at least half a second apart."""
    chosen: list[int] = []
    for row in errors.worst(int(known.sum())):
        if len(chosen) < LISTED_FRAMES and all(abs(row - other) > animation.fps / 2 for other in chosen):
            chosen.append(row)
    return chosen


def _extent(motion: Tensor) -> str:
    """The extent of motions `(frame, 4, 4)`, relative to the middle frame."""
    middle = motion[len(motion) // 2]
    degrees = torch.rad2deg(roma.rotmat_geodesic_distance(motion[:, :3, :3], middle[:3, :3].expand(len(motion), -1, -1)))
    distances = (motion - middle)[:, :3, 3].norm(dim=1)
    return f"up to {float(degrees.max()):.3g} degrees and {float(distances.max()):.3g} mm from the middle frame"


def _figures(values: Tensor) -> list[str]:
    return [f"{float(value):.3g}" for value in (values.mean(), values.median(), values.quantile(0.95), values.max())]


def _frame(animation: Animation, errors: FrameErrors, row: int) -> str:
    region = errors.worst_region[row]
    where = f", worst at {region}" if region else ""
    where = ", worst where no shape moves the mesh" if region == STILL else where
    return f"{int(animation.frame_numbers[row])} ({float(errors.mean_mm[row]):.2g} mm{where})"
