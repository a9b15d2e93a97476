"""A contact sheet of an inversion: the worst frames, and frames spread over the clip."""

from pathlib import Path

import numpy as np
import torch

from riginv.animation.animation import Animation, FrameErrors
from riginv.meshes.rendering import Camera, grid, heat_colors
from riginv.runs.files import atomic_write
from riginv.viewer.page import Targets, evaluated_rows, in_mm

WORST, SPREAD = 3, 3  # frames


@torch.no_grad()
def write_sheet(path: Path, animation: Animation, errors: FrameErrors, targets: Targets) -> None:
    """Write a PNG with target mesh, recovered mesh and a heat map of the error for each frame, on one scale.

    Unknown vertices are drawn at their recovered positions.

    Args:
        targets: as for `write_viewer`.
    """
    rows = sheet_rows(animation, errors)
    recovered = animation.rig(animation.controls[list(rows)])
    target_meshes = targets(list(rows)).to(recovered)
    target_meshes = torch.where(target_meshes.isnan(), recovered, target_meshes)
    distances = (target_meshes - recovered).norm(dim=2)
    top = float(distances.max().clamp_min(0.01))
    camera, faces, colors = Camera(animation.rig.rest_vertices), animation.rig.faces, animation.rig.vertex_colors()
    pictures, labels = [], []
    for (row, name), target, mesh, distance in zip(rows.items(), target_meshes, recovered, distances):
        view = camera.following(target, mesh)
        pictures += [view.picture(target, faces, colors), view.picture(mesh, faces, colors)]
        pictures.append(view.picture(mesh, faces, heat_colors(distance, top)))
        labels += [f"frame {int(animation.frame_numbers[row])}, {name}: clip", "recovered"]
        shown = (errors.mean_mm[row], errors.max_mm[row]) if errors.markers else (distance.mean(), distance.max())
        mean, largest = (in_mm(float(value)) for value in shown)
        labels.append(f"error: mean {mean} mm, largest {largest} mm; red is {top:.2g} mm")
    with atomic_write(path) as beside:
        grid(pictures, labels, columns=3).save(beside, format="PNG", optimize=True)


def sheet_rows(animation: Animation, errors: FrameErrors) -> dict[int, str]:
    """The rows that are drawn, each with its reason: the worst with some distance between them, then evenly spread ones."""
    rows, distance = evaluated_rows(animation, errors), max(1, len(animation) // 20)
    chosen: dict[int, str] = {}
    for index in errors.worst(len(rows)):
        row = rows[index]
        if row is not None and all(abs(row - other) >= distance for other in chosen):
            chosen[row] = f"worst {len(chosen) + 1}"
        if len(chosen) == WORST:
            break
    for row in np.linspace(0, len(animation) - 1, SPREAD).round().astype(int).tolist():
        chosen.setdefault(row, "evenly spread")
    return chosen
