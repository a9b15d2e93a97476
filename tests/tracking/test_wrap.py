"""A mesh wrapped onto a scan of another shape."""

import numpy as np
import pytest
import torch
import trimesh

from riginv.errors import InputError
from riginv.tracking.markers.placement import Placement
from riginv.tracking.surfaces.landmarks import Landmarks
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.triangles import TriangleMesh
from riginv.tracking.surfaces.wrap import wrap
from tests.conftest import ROOT
from tests.support.markers import placed, write_trc
from tests.support.scans import write_ply
from tests.support.toys import ToyRig
from tests.tracking.test_scans import NO_LOOK


def somebody(rig: ToyRig) -> TriangleMesh:
    """The toy's rest mesh bent and stretched, with vertices of its own, turned, moved and larger."""
    points = rig.rest_vertices.double().numpy() * [1.0, 1.12, 0.95]
    points[:, 0] += 2 * np.sin(points[:, 1] / 15)
    finer, faces = trimesh.remesh.subdivide_loop(points, rig.faces.numpy(), 1)
    motion = Motion.identity().after(np.radians([8.0, -6, 5]), np.array([20.0, -10, 15]), np.zeros(3))
    return TriangleMesh(motion.apply(1.1 * finer), faces)


def test_a_mesh_takes_the_shape_of_a_scan():
    rig, scan = ToyRig(detail=3), somebody(ToyRig(detail=3))
    found = wrap(rig.rest_vertices.numpy(), rig.faces.numpy(), scan)
    assert found.usable > 0.97 and np.nanmean(found.distance_mm) < 0.25
    np.testing.assert_allclose(found.motion.apply(found.scale * found.local), found.vertices, atol=1e-6)
    assert scan.closest(found.vertices).distance.mean() < 0.25


def test_a_scan_of_something_else_is_refused():
    rig, rng = ToyRig(detail=3), np.random.default_rng(0)
    needle = rng.normal(size=(400, 3)) * [300, 1, 1]
    hull = trimesh.convex.convex_hull(needle)
    with pytest.raises(InputError, match="cannot be brought onto"):
        wrap(rig.rest_vertices.numpy(), rig.faces.numpy(), TriangleMesh(hull.vertices, hull.faces))


def test_a_scan_that_is_inside_out_is_refused():
    rig, scan = ToyRig(detail=3), somebody(ToyRig(detail=3))
    with pytest.raises(InputError, match="the normals of the scan point inwards"):
        wrap(rig.rest_vertices.numpy(), rig.faces.numpy(), scan.reversed())


def turned(rig: ToyRig, degrees: float) -> tuple[TriangleMesh, np.ndarray]:
    """The scan of `somebody`, turned further, and where the toy's vertices lie on it, about."""
    scan = somebody(rig)
    axis = np.array([1.0, 0.5, 0.3])
    motion = Motion.identity().after(np.radians(degrees) * axis / np.linalg.norm(axis), np.array([60.0, 0, 0]), np.zeros(3))
    points = motion.apply(scan.points)
    return TriangleMesh(points, scan.faces), points[: len(rig.rest_vertices)]  # subdivision keeps the vertices first


def map_lines(placement: Placement, points: np.ndarray) -> list[str]:
    """The markers of a map with the position of each in a scan."""
    places = zip(placement.names, placement.corners.tolist(), placement.barycentric.tolist(), points.tolist())
    return [f"  {name}: {{triangle: {where}, barycentric: {weights}, point: {at}}}" for name, where, weights, at in places]


def test_landmarks_bring_a_neutral_onto_a_scan_that_was_turned(run, tmp_path):
    """Of a scan that serves as actor.neutral, and of frames of the clip, which is of scans that are turned alike."""
    rig = ToyRig(detail=3)
    scan, truth = turned(rig, 150.0)
    placement = placed(rig, 6)
    points = placement.points(torch.from_numpy(truth)).numpy()
    lines = ["rig: toy", "markers:", *map_lines(placement, points)]
    (tmp_path / "map.yaml").write_text("\n".join(lines))
    write_ply(tmp_path / "neutral.ply", scan.points, scan.faces)
    take = write_trc(tmp_path / "take.trc", placement.names, points[None])
    common = ("rig=toy", "+rig.detail=3", f"--config-dir={ROOT / 'tests/conf'}", f"clip={tmp_path / 'scan.%d.ply'}", *NO_LOOK)
    write_ply(tmp_path / "scan.1.ply", scan.points, scan.faces)
    of_clip = (f"landmarks.map={tmp_path / 'map.yaml'}", f"landmarks.clip={take}", "reading.unit=mm")
    shape = rig.rest_vertices.numpy() * [1.0, 1.12, 0.95]  # of somebody, without the bend
    for name, given in {
        "file": (f"actor.neutral={tmp_path / 'neutral.ply'}", f"actor.landmarks={tmp_path / 'map.yaml'}"),
        "frames": ("actor.neutral_frames=[1]",),
    }.items():
        done = run("invert", *common, *of_clip, f"out={name}", *given)
        assert done.code == 0 and "the landmarks lie" in done.text and "from the mesh's" in done.text, done.text
        with np.load(tmp_path / name / "actor.npz") as actor:
            found = actor["neutral"]
        away = {side: np.linalg.norm(found - found.mean(0) - 1.1 * side * shape, axis=1).mean() for side in (1.0, -1.0)}
        assert away[1.0] < 8 < away[-1.0], away


def test_landmarks_bring_a_mesh_onto_a_scan_that_was_turned_by_150_degrees(run, tmp_path):
    rig = ToyRig(detail=3)
    scan, truth = turned(rig, 150.0)
    plain = wrap(rig.rest_vertices.numpy(), rig.faces.numpy(), scan)
    assert np.linalg.norm(plain.vertices - truth, axis=1).mean() > 20  # it lies on the scan, with another side up
    placement, rng = placed(rig, 6), np.random.default_rng(0)
    points = placement.points(torch.from_numpy(truth)).numpy() + rng.normal(0, 1.0, (6, 3))
    found = wrap(rig.rest_vertices.numpy(), rig.faces.numpy(), scan, landmarks=Landmarks(placement, points))
    assert np.linalg.norm(found.vertices - truth, axis=1).mean() < 4.0  # on a ball it may slide
    assert found.usable > 0.97 and np.nanmean(found.distance_mm) < 0.25

    write_ply(tmp_path / "neutral.ply", scan.points / 1000, scan.faces)  # in metres
    lines = map_lines(placement, points / 1000)
    (tmp_path / "map.yaml").write_text("\n".join(["rig: toy", "markers:", *lines]))
    given = ("rig=toy", "+rig.detail=3", f"--config-dir={ROOT / 'tests/conf'}", f"scan={tmp_path / 'neutral.ply'}")
    given = (*given, f"landmarks={tmp_path / 'map.yaml'}")
    done = run("wrap", *given, f"out={tmp_path / 'wrapped.obj'}")
    assert done.code == 0 and "the landmarks lie" in done.text, done.text
    done, made = run("wrap", *given, f"out={tmp_path / 'wrapped.obj'}"), (tmp_path / "wrapped.obj").read_bytes()
    assert done.code == 1 and "it is there already" in done.text and (tmp_path / "wrapped.obj").read_bytes() == made
    for old, new, words in [
        ("point", "offset_mm: 0, pint", "expected vertex: NUMBER"),
        ("point: [", "point: [.nan, ", "expected its position in the scan"),
        (", point: [", ", offset_mm: 0} # [", "marker 'm00' has point None"),
        ("m00", "m01", "is there twice"),
        ("point: [", "point: [9.0, 0.0, 0.0]} # [", "mm from the scan, expected near it"),
    ]:
        (tmp_path / "map.yaml").write_text("\n".join(["rig: toy", "markers:", *lines]).replace(old, new))
        done = run("wrap", *given, f"out={tmp_path / 'again.obj'}")
        assert done.code == 1 and words in done.text and "Traceback" not in done.text, done.text
    (tmp_path / "map.yaml").write_text("\n".join(["markers:", *lines[:2]]))
    done = run("wrap", *given, f"out={tmp_path / 'again.obj'}")
    assert done.code == 1 and "2 landmarks, expected 3 at least" in done.text


def test_the_command_leaves_the_mesh_and_a_picture(run, tmp_path):
    rig, scan = ToyRig(), somebody(ToyRig(detail=3))
    write_ply(tmp_path / "neutral.ply", scan.points / 1000, scan.faces)  # in metres
    config = f"--config-dir={ROOT / 'tests/conf'}"
    done = run("wrap", "rig=toy", config, f"scan={tmp_path / 'neutral.ply'}", f"out={tmp_path / 'wrapped.obj'}")
    assert done.code == 0, done.text
    vertices = [line.split()[1:] for line in (tmp_path / "wrapped.obj").read_text().splitlines() if line.startswith("v ")]
    assert len(vertices) == len(rig.rest_vertices) and (tmp_path / "wrapped.png").stat().st_size > 1000
    assert scan.closest(np.array(vertices, float)).distance.mean() < 1.0


def test_a_prior_is_learned_and_used_from_the_command_line(run, tmp_path):
    rig = ToyRig()
    controls = rig.lower + (rig.upper - rig.lower) * torch.rand(40, 7)
    header = ",".join(["frame", "seconds", *rig.control_names])
    rows = [f"{number},0,{','.join(map(str, row))}" for number, row in enumerate(controls.tolist())]
    (tmp_path / "curves.csv").write_text("\n".join([header, *rows]))
    config = f"--config-dir={ROOT / 'tests/conf'}"
    done = run("learn_prior", "rig=toy", config, f"takes=[{tmp_path / 'curves.csv'}]", f"out={tmp_path / 'prior'}")
    assert done.code == 0 and "40 frames" in done.text, done.text
    with torch.no_grad():
        np.savez(tmp_path / "take.npz", vertices=rig(controls[:6]).numpy(), fps=30.0)
    look = ["look.page=false", "look.sheet=false", "method=levenberg_marquardt"]
    take = ["rig=toy", config, f"clip={tmp_path / 'take.npz'}", f"prior={tmp_path / 'prior'}"]
    done = run("invert", *take, f"out={tmp_path / 'got'}", *look)
    assert done.code == 0, done.text
    done = run("learn_prior", "rig=toy", config, "takes=[nowhere.csv]", f"out={tmp_path / 'other'}")
    assert done.code == 1 and "nowhere.csv" in done.text and not (tmp_path / "other").exists()
