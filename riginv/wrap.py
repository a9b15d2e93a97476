"""python -m riginv.wrap: the mesh of a rig fitted to a scan of a neutral face."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "wrap")  # before the imports that take seconds

from dataclasses import dataclass, replace

import numpy as np
import torch
from omegaconf import DictConfig
from PIL import Image
from rich.console import Console

from riginv.clips.options import ReadingOptions
from riginv.config.building import ClassSpec
from riginv.config.typed import to_typed
from riginv.meshes.obj import obj_text
from riginv.meshes.rendering import Camera, grid, heat_colors
from riginv.rig.interface import RigBackend
from riginv.runs.console import show_lines
from riginv.runs.files import atomic_write, free_file, write_text
from riginv.runs.threads import single_threaded
from riginv.tracking.surfaces.landmark_files import landmarks_of_scan
from riginv.tracking.surfaces.scan_files import read_scan
from riginv.tracking.surfaces.triangles import Surface, TriangleMesh
from riginv.tracking.surfaces.wrap import Wrapped, WrapSettings, wrap

RED_MM = 1.0  # the distance that the picture shows as dark red


@dataclass(frozen=True)
class WrapConfig:
    """The config of `riginv.wrap`; conf/wrap.yaml explains each key."""

    rig: ClassSpec[RigBackend]
    scan: str
    out: str
    landmarks: str | None
    unit: str | float
    up: str
    reading: ReadingOptions


@single_threaded()  # operations are small
def run(config: DictConfig) -> None:
    """Wrap the mesh of `config.rig` onto `config.scan`; write `config.out` and a picture of the distances."""
    settings = to_typed(config, WrapConfig)
    out = free_file(settings.out, ".obj", ".png")
    rig = settings.rig.build()
    scan, units = read_scan(settings.scan, replace(settings.reading, fps=settings.reading.fps or 1.0), rig)
    show_lines([], units.notes, console=Console())
    surface = scan.surface(units.mm, units.axes.double().numpy())
    landmarks = landmarks_of_scan(settings.landmarks, rig, scan.points, units)
    found = wrap(rig.rest_vertices.cpu().numpy(), rig.faces.cpu().numpy(), surface, WrapSettings(), landmarks)
    write_text(out, obj_text(found.vertices, rig.faces.cpu().numpy()))
    picture = out.with_suffix(".png")
    with atomic_write(picture) as file:
        distance_map(rig, found, surface).save(file, format="PNG")
    mean = float(np.nanmean(found.distance_mm))
    lines = [] if landmarks is None else [f"  {landmarks.away_from(found.vertices)}"]
    lines += [
        f"  {found.usable:.1%} of the outer skin lies on the scan, at {mean:.3g} mm on average; scale {found.scale:.3f}",
        f"  {out}, {picture}",
    ]
    show_lines(lines, console=Console())


def distance_map(rig: RigBackend, found: Wrapped, surface: Surface) -> Image.Image:
    """A picture of the scan, the wrapped mesh, and its distance from the scan: dark red from 1 mm, and off the scan."""
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
