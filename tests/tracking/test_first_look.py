"""The first scan is looked at before any work starts: its unit, and the side that its normals point to."""

import csv

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from riginv.clips.options import ReadingOptions
from riginv.clips.units import ClipUnits
from riginv.errors import InputError
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.stability import stability_weights
from riginv.tracking.surfaces.first_look import checked_units
from riginv.tracking.surfaces.scan_files import open_scans
from riginv.tracking.surfaces.solving import ScanSolver
from riginv.tracking.surfaces.units import resolve_scan_units
from tests.support.scans import posed_mesh, write_ragged
from tests.support.toys import ToyRig
from tests.tracking.test_scans import CONF, NO_LOOK, scans_of

TURN = Rotation.from_rotvec(np.radians(70) * np.array([0.5, 0.8, 0.3])).as_matrix()
PARTS = {
    "whole": lambda centres, middle: np.ones(len(centres), bool),
    "left": lambda centres, middle: centres[:, 0] > 0,
}


@pytest.fixture(scope="module")
def solver(face) -> ScanSolver:
    return ScanSolver(face, default_prior(face), stability=stability_weights(face).numpy())


def looked_at(solver: ScanSolver, path, part: str, turn: np.ndarray, factor: float, inwards: bool) -> ClipUnits:
    """The units of a scan of the face with a half open jaw, of which the file says no unit."""
    controls = solver.rig.neutral_controls.clone()
    controls[solver.rig.control_names.index("jawOpen")] = 0.3
    points, faces = posed_mesh(solver.rig, controls)
    faces = faces[PARTS[part](points[faces].mean(axis=1), np.median(points, axis=0))]
    write_ragged(path, [(factor * points @ turn.T, faces[:, ::-1] if inwards else faces)])
    scans, reading = open_scans(str(path), solver.rig, ReadingOptions()), ReadingOptions(fps=1.0)
    return checked_units(scans, resolve_scan_units(scans, solver.rig, reading), reading, solver)


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("mm", [10.0, 25.4])
def test_inches_are_told_from_centimetres_in_half_a_face(solver, tmp_path, part, mm):
    assert looked_at(solver, tmp_path / "scan.npz", part, np.eye(3), 1 / mm, False).mm == mm


def test_a_turned_scan_that_is_inside_out_is_refused_before_it_is_solved(solver, tmp_path):
    with pytest.raises(InputError, match="scan.npz: the normals of its first scan point inwards"):
        looked_at(solver, tmp_path / "scan.npz", "whole", TURN, 1.0, True)
    assert looked_at(solver, tmp_path / "scan.npz", "whole", TURN, 1.0, False).mm == 1


def test_scans_that_are_inside_out_are_said_to_be(run, tmp_path):
    write_ragged(tmp_path / "take.npz", [(points, faces[:, ::-1]) for points, faces in scans_of(ToyRig())], fps=30.0)
    done = run("invert", "rig=toy", f"--config-dir={CONF}", f"clip={tmp_path / 'take.npz'}", "out=got")
    assert done.code == 1 and "normals" in done.text
    assert "the normals of its first scan point inwards" in done.text and not (tmp_path / "got").exists()


def test_inches_are_told_from_centimetres_by_the_fit(run, tmp_path):
    write_ragged(tmp_path / "take.npz", [(points / 25.4, faces) for points, faces in scans_of(ToyRig())], fps=30.0)
    done = run("invert", "rig=toy", f"--config-dir={CONF}", f"clip={tmp_path / 'take.npz'}", "out=got", *NO_LOOK)
    assert done.code == 0 and "unit inch (guessed)" in done.text and "units of inches guessed" in done.text, done.text
    assert "units of cm" not in done.text
    rows = list(csv.DictReader((tmp_path / "got/scans.csv").read_text().splitlines()))
    assert all(float(row["scan_to_rig_mm"]) < 0.1 for row in rows)
