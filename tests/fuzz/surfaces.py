"""Files of scans, markers and priors, whole, with what reads them."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import trimesh

from riginv.clips.markers import open_markers
from riginv.clips.options import ReadingOptions
from riginv.clips.units import ClipUnits
from riginv.tracking.markers.assembly import in_millimetres, marker_units
from riginv.tracking.markers.map_file import matched, read_map, write_map
from riginv.tracking.options import LandmarkOptions
from riginv.tracking.priors.files import load_prior, save_prior
from riginv.tracking.priors.prior import ControlPrior, learn_prior
from riginv.tracking.surfaces.landmark_files import landmarks_of_scan, read_landmarks
from riginv.tracking.surfaces.scan_files import open_scans
from riginv.tracking.surfaces.triangles import Surface
from riginv.tracking.surfaces.units import resolve_scan_units
from tests.fuzz.tally import Target
from tests.support.clips import reading_options
from tests.support.markers import placed, played, write_c3d, write_csv, write_motive, write_trc, write_vicon
from tests.support.scans import new_stage, resampled, usd_mesh, write_alembic, write_ragged
from tests.support.toys import ToyRig

WRITERS = {".c3d": write_c3d, ".trc": write_trc, ".csv": write_csv, ".motive.csv": write_motive, ".vicon.csv": write_vicon}


def _rig() -> ToyRig:
    return ToyRig(detail=1)


def read_scans(path: Path) -> list[Surface]:
    """As the command does: opened, measured, and made into surfaces one by one."""
    scans = open_scans(str(path), _rig(), reading_options())
    units = resolve_scan_units(scans, _rig(), ReadingOptions())
    found = [scans.cleaned(number) for number in range(len(scans))]
    surfaces = [scan.surface(units.mm, np.eye(3)) for scan in found if scan is not None]
    assert all(np.isfinite(surface.points).all() for surface in surfaces)
    return surfaces


def read_prior(folder: Path) -> ControlPrior:
    """As a solver takes it: with the inverse of its covariance."""
    prior = load_prior(folder, _rig())
    assert bool(torch.isfinite(prior.precision).all())
    return prior


def _meshes() -> list[tuple[np.ndarray, np.ndarray]]:
    """Two scans of other faces each."""
    found = [resampled(_rig(), torch.full((7,), 0.2), seed) for seed in range(2)]
    return [(mesh.points, mesh.faces[5 * number :]) for number, mesh in enumerate(found)]


def ragged(folder: Path) -> Target:
    """A clip of two scans."""
    write_ragged(folder / "scans.npz", _meshes())
    return Target([folder / "scans.npz"], lambda: read_scans(folder / "scans.npz"))


def stills(kind: str) -> Callable[[Path], Target]:
    """A folder of files, a scan each, of a kind that trimesh writes: `stl`, `stl_ascii`, `ply`, `obj`, `glb`."""

    def make(folder: Path) -> Target:
        paths = [folder / f"scan.{number}.{kind.partition('_')[0]}" for number in range(2)]
        for path, mesh in zip(paths, _meshes()):
            data = trimesh.Trimesh(*mesh, process=False).export(file_type=kind)
            path.write_bytes(data.encode() if isinstance(data, str) else data)
        return Target(paths, lambda: read_scans(folder))

    return make


def stage(suffix: str) -> Callable[[Path], Target]:
    """A USD stage whose faces change from frame to frame."""

    def make(folder: Path) -> Target:
        path = folder / f"scans{suffix}"
        scene = new_stage(path)
        for number, mesh in enumerate(_meshes()):
            usd_mesh(scene, *mesh, number)
        scene.Save()
        return Target([path], lambda: read_scans(path))

    return make


def archive(folder: Path) -> Target:
    """An Alembic archive whose faces change from frame to frame; made and read by Blender."""
    path = write_alembic(folder, *_meshes()[0])
    return Target([path], lambda: read_scans(path))


def landmarks(folder: Path) -> Target:
    """The landmarks of one scan, as of `riginv.wrap`."""
    rig, (points, _), placement = _rig(), _meshes()[0], placed(_rig(), 5)
    write_map(folder / "map.yaml", placement, rig)
    at = iter(placement.points(rig.rest_vertices).tolist())
    text = re.sub(r"\}", lambda match: f", point: {next(at)}}}", (folder / "map.yaml").read_text())
    (folder / "map.yaml").write_text(text)
    units = ClipUnits(1.0, torch.eye(3), 30.0, [])
    return Target([folder / "map.yaml"], lambda: landmarks_of_scan(str(folder / "map.yaml"), rig, points, units))


def landmark_take(suffix: str) -> Callable[[Path], Target]:
    """The landmarks of a clip of scans: a map and a take."""

    def make(folder: Path) -> Target:
        whole, placement, take = ragged(folder), placed(_rig(), 5), folder / f"take{suffix}"
        write_map(folder / "map.yaml", placement, _rig())
        WRITERS[suffix](take, placement.names, np.tile(placement.points(_rig().rest_vertices).numpy(), (2, 1, 1)))
        options = LandmarkOptions(str(folder / "map.yaml"), str(take))
        scans, reading = open_scans(str(whole.victims[0]), _rig(), reading_options()), ReadingOptions(unknown="ignore_both")
        units = resolve_scan_units(scans, _rig(), reading)

        def read() -> None:
            found, _ = read_landmarks(options, _rig(), reading, scans, units)
            assert found is not None and not np.isinf(found.points).any()

        return Target([folder / "map.yaml", take], read)

    return make


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
