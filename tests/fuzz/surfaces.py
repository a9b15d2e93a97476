"""Files of scans, markers and priors, whole, with what reads them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from riginv.clips.markers import open_markers
from riginv.clips.options import ReadingOptions
from riginv.tracking.markers.assembly import in_millimetres, marker_units
from riginv.tracking.markers.map_file import matched, read_map, write_map
from riginv.tracking.priors.files import load_prior, save_prior
from riginv.tracking.priors.prior import ControlPrior, learn_prior
from riginv.tracking.surfaces.scan_files import RaggedArrays
from riginv.tracking.surfaces.triangles import Surface
from riginv.tracking.surfaces.units import resolve_scan_units
from tests.fuzz.tally import Target
from tests.support.markers import placed, played, write_c3d, write_csv, write_motive, write_trc, write_vicon
from tests.support.scans import resampled, write_ragged
from tests.support.toys import ToyRig

WRITERS = {".c3d": write_c3d, ".trc": write_trc, ".csv": write_csv, ".motive.csv": write_motive, ".vicon.csv": write_vicon}


def _rig() -> ToyRig:
    return ToyRig(detail=1)


def read_scans(path: Path) -> list[Surface]:
    """As the command does: opened, measured, and made into surfaces one by one."""
    scans = RaggedArrays(path)
    units = resolve_scan_units(scans, _rig(), ReadingOptions())
    found = [scans.scan(number).cleaned() for number in range(len(scans))]
    surfaces = [scan.surface(units.mm, np.eye(3)) for scan in found if scan is not None]
    assert all(np.isfinite(surface.points).all() for surface in surfaces)
    return surfaces


def read_prior(folder: Path) -> ControlPrior:
    """As a solver takes it: with the inverse of its covariance."""
    prior = load_prior(folder, _rig())
    assert bool(torch.isfinite(prior.precision).all())
    return prior


def ragged(folder: Path) -> Target:
    """A clip of two scans."""
    meshes = [resampled(_rig(), torch.full((7,), 0.2), seed) for seed in range(2)]
    write_ragged(folder / "scans.npz", [(mesh.points, mesh.faces) for mesh in meshes])
    return Target([folder / "scans.npz"], lambda: read_scans(folder / "scans.npz"))


def prior(folder: Path) -> Target:
    """A learned prior."""
    rig = _rig()
    save_prior(folder / "prior", learn_prior(rig, rig.lower + (rig.upper - rig.lower) * torch.rand(30, 7)), rig, 30)
    return Target(sorted((folder / "prior").iterdir()), lambda: read_prior(folder / "prior"))


def read_markers(path: Path) -> torch.Tensor:
    """As the command does: opened, compared with a map, and in millimetres."""
    placement = placed(_rig(), 6)
    clip, shared, _ = matched(open_markers(str(path)), placement, "map", ReadingOptions(unknown="ignore_both"))
    points = in_millimetres(clip.points, marker_units(clip, shared, _rig(), ReadingOptions()))
    assert points.shape[1:] == (len(shared), 3) and not bool(torch.isinf(points).any())
    return points


def markers(suffix: str) -> Callable[[Path], Target]:
    """A take of markers."""

    def make(folder: Path) -> Target:
        placement, rig = placed(_rig(), 6), _rig()
        path = folder / f"take{suffix}"
        with torch.no_grad():
            points = placement.points(rig(played(rig, 8))).numpy()
        points[3, 2] = np.nan
        WRITERS[suffix](path, placement.names, points)
        return Target([path], lambda: read_markers(path))

    return make


def marker_map(folder: Path) -> Target:
    """The places of markers on a rig."""
    write_map(folder / "map.yaml", placed(_rig(), 6, 1.0), _rig())
    return Target([folder / "map.yaml"], lambda: read_map(folder / "map.yaml", _rig()))
