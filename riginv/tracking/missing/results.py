"""The folder of missing shapes: sculpts as OBJ, deltas as .npz, a table as JSON, a picture, and the lines for the terminal."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.table import Table
from torch import Tensor

from riginv.errors import InputError
from riginv.meshes.obj import obj_text
from riginv.meshes.reading import read_mesh
from riginv.meshes.rendering import Camera, grid, heat_colors
from riginv.rig.interface import LinearRig
from riginv.runs.files import atomic_write, write_json, write_text
from riginv.runs.tables import new_table
from riginv.tracking.missing.drivers import Driver
from riginv.tracking.missing.finding import Missing, RigWithShapes

DELTAS, TABLE, PICTURE = "shapes.npz", "missing.json", "missing.png"
IN_USE = 0.1  # weight of a shape in the frames that are counted


def rows_of(missing: Missing, frame_numbers: Tensor) -> list[dict[str, Any]]:
    """A row of facts for each shape."""
    rig, rows = missing.rig, []
    for number, driver in enumerate(rig.drivers):
        lengths, weights = missing.shapes[number].norm(dim=1), missing.weights[:, number]
        rows.append(
            {
                "name": driver.name,
                "drivers": [rig.factors.names[factor] for factor in driver.factors],
                "largest_mm": round(float(lengths.max()), 4),
                "vertices": int((lengths > 0).sum()),
                "frames": int((weights > IN_USE).sum()),
                "peak_frame": int(frame_numbers[weights.argmax()]),
                "peak_weight": round(float(weights.max()), 4),
                "mean_error_mm_with_first": round(missing.with_first_mm[number], 6),
            }
        )
    return rows


def sentence(missing: Missing) -> str:
    """The effect of all shapes on the error, in one sentence."""
    before, after = float(missing.before_mm.mean()), float(missing.after_mm.mean())
    count, percent = len(missing.shapes), 100 * (1 - after / max(before, 1e-12))
    shapes = "1 shape" if count == 1 else f"{count} shapes"
    return (
        f"{shapes} would remove {percent:.0f} % of the error that remains: {before:.3g} mm to {after:.3g} mm, mean over "
        f"{len(missing.before_mm)} frames."
    )


def table_of(missing: Missing, rows: list[dict[str, Any]]) -> Table:
    """The table for the terminal: each shape with the mean error that it and those above it leave."""
    table = new_table(("driven by", "largest\nmm", "vertices", "frames", "peak\nframe", "error\nwith it"), "Missing shapes")
    for row in rows:
        called = " x ".join(row["drivers"])
        error = f"{row['mean_error_mm_with_first']:.3g}"
        table.add_row(
            called, f"{row['largest_mm']:.2f}", f"{row['vertices']:,}", f"{row['frames']:,}", str(row["peak_frame"]), error
        )
    return table


def write_missing(folder: Path, missing: Missing, rows: list[dict[str, Any]]) -> list[str]:
    """Write all files into a folder; returns their names."""
    rig, source, names = missing.rig, missing.rig.source, []
    deltas: dict[str, Any] = {}
    pictures, labels = [], []
    camera, polygons = Camera(source.rest_vertices), _polygons(source)
    for row, driver, shape in zip(rows, rig.drivers, missing.shapes):
        pose = rig.factors.pose(driver)
        sculpt = source(pose)[0] + shape
        deltas[driver.name] = (delta_to_add(rig, driver, shape) / source.unit_mm).cpu().numpy().astype(np.float32)
        names.append(f"{driver.name}.obj")
        write_text(folder / names[-1], obj_text((sculpt / source.unit_mm).cpu().numpy(), polygons, header="", digits=".7g"))
        heat = heat_colors(shape.norm(dim=1), row["largest_mm"])
        pictures.append(camera.following(sculpt).picture(sculpt, source.faces, heat))
        labels.append(f"{driver.name}: red {row['largest_mm']:.1f} mm, frame {row['peak_frame']}")
    with atomic_write(folder / DELTAS) as file:
        with open(file, "wb") as stream:
            np.savez_compressed(stream, **deltas)
    with atomic_write(folder / PICTURE) as file:
        grid(pictures, labels, columns=min(6, len(pictures))).save(file, format="PNG")
    before, after = float(missing.before_mm.mean()), float(missing.after_mm.mean())
    facts = {"sentence": sentence(missing), "mean_error_mm": before, "mean_error_mm_with_shapes": after, "shapes": rows}
    write_json(folder / TABLE, {"rig": source.name, "unit_mm": source.unit_mm, **facts})
    return [TABLE, PICTURE, DELTAS, f"{len(names)} OBJ file{'s' if len(names) > 1 else ''}"]


def delta_to_add(rig: RigWithShapes, driver: Driver, shape: Tensor) -> Tensor:
    """The delta `(vertex, 3)`, mm, that a folder takes for a shape: in-betweens make room for a new one beside them."""
    near = rig.factors.neighbours(driver)
    weights = rig.source.coefficients(rig.factors.pose(driver))[0, near, None, None]
    return shape + (weights * rig.source.basis[near]).sum(dim=0)


def _polygons(rig: LinearRig) -> list[list[int]]:
    """The polygons of the rig's own mesh file, so that sculpts match it; its triangles where there is none."""
    if rig.mesh_file is not None:
        try:
            polygons = read_mesh(rig.mesh_file).polygons()
        except InputError:
            polygons = None
        if polygons is not None:
            return [polygons.face(number).tolist() for number in range(len(polygons))]
    return torch.as_tensor(rig.faces).tolist()
