"""Files of scans and priors, whole, with what reads them."""

from pathlib import Path

import numpy as np
import torch

from riginv.clips.options import ReadingOptions
from riginv.tracking.priors.files import load_prior, save_prior
from riginv.tracking.priors.prior import ControlPrior, learn_prior
from riginv.tracking.surfaces.scan_files import RaggedArrays
from riginv.tracking.surfaces.triangles import Surface
from riginv.tracking.surfaces.units import resolve_scan_units
from tests.fuzz.tally import Target
from tests.support.scans import resampled, write_ragged
from tests.support.toys import ToyRig


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
