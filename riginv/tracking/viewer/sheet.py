"""A contact sheet of an inversion: the worst frames, and frames spread over the clip."""

from pathlib import Path

import numpy as np
import torch

from riginv.animation.animation import Animation, FrameErrors
from riginv.meshes.rendering import Camera, grid, heat_colors
from riginv.runs.files import atomic_write
from riginv.tracking.viewer.page import Targets, evaluated_rows, in_mm
from riginv.tracking.viewer.scans import Scans

WORST, SPREAD = 3, 3  # frames


@torch.no_grad()
def write_sheet(path: Path, animation: Animation, errors: FrameErrors, targets: Targets, scans: Scans | None = None) -> None:
    """Write a PNG with target mesh, recovered mesh and a heat map of the error for each frame, on one scale.

    Unknown vertices are drawn at their recovered positions, and grey in the heat map.

    Args:
        targets, scans: as for `write_viewer`; a scan of triangles is drawn in the colours of its distances from the rig.
    """
    rows = sheet_rows(animation, errors)
    recovered = animation.rig(animation.controls[list(rows)])
    target_meshes = targets(list(rows)).to(recovered)
    distances = (target_meshes - recovered).norm(dim=2)
    target_meshes = torch.where(target_meshes.isnan(), recovered, target_meshes)
    skin = None if scans is None else scans.skin
    top = max(float(distances[:, :skin].nan_to_num(0.0).max()), 0.01)
    camera, faces, colors = Camera(animation.rig.rest_vertices), animation.rig.faces, animation.rig.vertex_colors()
    pictures, labels = [], []
    for (row, name), target, mesh, distance in zip(rows.items(), target_meshes, recovered, distances):
        view = camera.following(target, mesh)
        scan = None if scans is None else scans.drawn(row)
        if scan is not None and len(scan.faces):
            heat = heat_colors(torch.from_numpy(scan.distance), top)
            pictures.append(view.picture(torch.from_numpy(scan.points), torch.from_numpy(scan.faces), heat))
        else:
            pictures.append(view.picture(target, faces, colors))
        pictures += view.pictures(mesh, faces, [colors, heat_colors(distance, top)])
        labels += [f"frame {int(animation.frame_numbers[row])}, {name}: clip", "recovered"]
        known = distance[~distance.isnan()]
        of_mesh = scan is None and not errors.markers and len(known)
        shown = (known.mean(), known.max()) if of_mesh else (errors.mean_mm[row], errors.max_mm[row])
        mean, largest = (in_mm(float(value)) for value in shown)
        names = ("error: mean", "largest") if scan is None else ("scan to rig", "rig to scan")
        labels.append(f"{names[0]} {mean} mm, {names[1]} {largest} mm; red is {top:.2g} mm")
    with atomic_write(path) as beside:
        grid(pictures, labels, columns=3).save(beside, format="PNG")


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
