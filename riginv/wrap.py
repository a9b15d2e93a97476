"""python -m riginv.wrap: the mesh of a rig fitted to a scan of somebody's neutral face."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig
from PIL import Image
from rich.console import Console

from riginv.clips.options import ReadingOptions
from riginv.config.building import build
from riginv.errors import InputError
from riginv.launch.command import command
from riginv.meshes.rendering import Camera, grid, heat_colors
from riginv.rig.interface import RigBackend
from riginv.runs.files import atomic_write, write_text
from riginv.runs.run_folder import plain_config
from riginv.tracking.surfaces.scans import FileScans, Scan
from riginv.tracking.surfaces.triangles import TriangleMesh
from riginv.tracking.surfaces.units import resolve_scan_units
from riginv.tracking.surfaces.wrap import Wrapped, WrapSettings, wrap

RED_MM = 1.0  # the distance that the picture shows as dark red


def run(config: DictConfig) -> None:
    """Wrap the mesh of `config.rig` onto `config.scan`, and leave `config.out` and a picture of the distances beside it."""
    plain = plain_config(config)
    out, console = Path(str(plain["out"])), Console()
    if out.suffix.lower() != ".obj":
        raise InputError(f"out={out}: expected a file that ends in .obj")
    rig = build(plain["rig"], kind=RigBackend)
    scan, units = _scan(plain, rig)
    for note in units.notes:
        console.print(f"note: {note}", highlight=False, markup=False)
    surface = scan.surface(units.mm, units.axes.double().numpy())
    found = wrap(rig.rest_vertices.cpu().numpy(), rig.faces.cpu().numpy(), surface, WrapSettings())
    write_text(out, obj_text(found.vertices, rig.faces.cpu().numpy()))
    picture = out.with_suffix(".png")
    with atomic_write(picture) as beside:
        distance_map(rig, found, surface).save(beside, format="PNG", optimize=True)
    mean = float(np.nanmean(found.distance_mm))
    console.print(
        f"  {found.usable:.1%} of the outer skin lies on the scan, at {mean:.3g} mm on average; scale {found.scale:.3f}",
        highlight=False,
    )
    console.print(f"  {out}, {picture}", highlight=False, markup=False)


def _scan(plain: dict[str, Any], rig: RigBackend) -> tuple[Scan, Any]:
    reading = ReadingOptions(unit=plain["unit"], up=plain["up"], fps=1.0)
    scans = FileScans(str(plain["scan"]), reading)
    if len(scans) != 1:
        raise InputError(f"scan={plain['scan']}: {len(scans)} files, expected one scan of a neutral face")
    scan = scans.scan(0)
    cleaned = None if scan is None else scan.cleaned()
    if cleaned is None:
        raise InputError(f"scan={plain['scan']}: fewer than 50 points: there is nothing to fit")
    return cleaned, resolve_scan_units(scans, rig, reading)


def obj_text(vertices: np.ndarray, faces: np.ndarray) -> str:
    """A Wavefront OBJ of vertices `(vertex, 3)` and faces `(face, 3)`, in their order."""
    lines = ["# millimetres, y up", *(f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in vertices.tolist())]
    return "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist())]) + "\n"


def distance_map(rig: RigBackend, found: Wrapped, surface: Any) -> Image.Image:
    """The scan, the wrapped mesh, and its distance as heat: dark red from 1 mm, and where it is off the scan."""
    vertices = torch.from_numpy(found.vertices)
    camera = Camera(vertices)
    heat = heat_colors(torch.from_numpy(np.nan_to_num(found.distance_mm, nan=RED_MM)), RED_MM)
    pictures = [camera.picture(vertices, rig.faces), camera.picture(vertices, rig.faces, heat)]
    labels = ["wrapped", f"distance: mean {float(np.nanmean(found.distance_mm)):.2f}, red {RED_MM:g} mm"]
    if isinstance(surface, TriangleMesh):
        pictures.insert(0, camera.picture(torch.from_numpy(surface.points), torch.from_numpy(surface.faces)))
        labels.insert(0, "scan")
    return grid(pictures, labels, columns=len(pictures))


if __name__ == "__main__":
    command("wrap")(run)()
