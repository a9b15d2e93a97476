"""Clips of scans: read, understood, and inverted from the command line."""

import csv

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import Polygons
from riginv.errors import InputError
from riginv.tracking.surfaces.scan_files import FileScans, RaggedArrays, open_scans
from riginv.tracking.surfaces.scans import Scan
from riginv.tracking.surfaces.solving import ScanSolver
from riginv.tracking.surfaces.units import resolve_scan_units
from tests.conftest import ROOT
from tests.support.pages import read_page
from tests.support.scans import posed_mesh, resampled, write_ply, write_ragged
from tests.support.toys import ToyRig

NO_LOOK = ("look.page=false", "look.sheet=false")
CONF = ROOT / "tests/conf"
CONTROLS = torch.tensor([0.3, 0.6, 0.2, 0.5, 0.4, -0.5, 0.3])


def scans_of(rig: ToyRig, count: int = 3) -> list[tuple[np.ndarray, np.ndarray]]:
    """Scans with a different number of points each."""
    found = []
    for number in range(count):
        mesh = resampled(rig, CONTROLS * (0.6 + 0.2 * number), number)
        keep = np.arange(len(mesh.faces)) >= 10 * number
        cut = Scan(mesh.points, mesh.faces[keep]).cleaned()
        found.append((cut.points, cut.faces))
    return found


def test_ragged_arrays_come_back_frame_by_frame(tmp_path):
    given = scans_of(ToyRig())
    write_ragged(tmp_path / "take.npz", given, fps=24.0)
    scans = RaggedArrays(tmp_path / "take.npz")
    assert len(scans) == 3 and scans.fps == 24
    for number, (points, faces) in enumerate(given):
        np.testing.assert_allclose(scans.scan(number).points, points, atol=1e-4)
        np.testing.assert_array_equal(scans.scan(number).faces, faces)


@pytest.mark.parametrize(
    "change",
    [
        {"offsets": np.array([0, 5])},
        {"offsets": np.array([0, 90, 60, 10])},
        {"points": np.zeros((4, 2))},
        {"face_offsets": np.array([0, 1])},
        {"faces": np.zeros((3, 3), np.int64)},
        {"frame_numbers": np.array([3, 2, 1])},
        {"fps": np.array([1.0, 2.0])},
        {"points": np.array(["a"])},
    ],
)
def test_ragged_arrays_that_contradict_themselves_are_refused(tmp_path, change):
    write_ragged(tmp_path / "take.npz", scans_of(ToyRig()), **change)
    with pytest.raises(InputError):
        RaggedArrays(tmp_path / "take.npz").scan(0)


def test_a_face_that_uses_no_vertex_is_refused(tmp_path):
    given = scans_of(ToyRig())
    given[0][1][5, 1] = 10**6
    write_ragged(tmp_path / "take.npz", given)
    with pytest.raises(InputError, match="uses vertex 1000000"):
        RaggedArrays(tmp_path / "take.npz").scan(0)


def test_files_of_different_meshes_are_one_clip(tmp_path):
    for number, (points, faces) in enumerate(scans_of(ToyRig())):
        write_ply(tmp_path / f"scan.{number:03d}.ply", points, faces)
    for path in (tmp_path / "scan.%03d.ply", tmp_path):
        scans = open_scans(str(path), ToyRig(), ReadingOptions())
        assert [len(scans.scan(number).points) for number in range(3)] == [len(points) for points, _ in scans_of(ToyRig())]
    write_ply(tmp_path / "scan.003.obj", *scans_of(ToyRig())[0])
    with pytest.raises(InputError, match=r"a folder of \.obj, \.ply files, expected one format: '.*/\*\.obj' names one"):
        open_scans(str(tmp_path), ToyRig(), ReadingOptions())


def test_a_scan_that_is_asked_for_again_is_read_once(tmp_path, monkeypatch):
    for number in (1, 2):
        write_ply(tmp_path / f"scan.{number}.ply", np.random.default_rng(number).normal(0, 50, (60, 3)), None)
    scans, read = FileScans(str(tmp_path / "scan.%d.ply"), ReadingOptions()), []
    monkeypatch.setattr(scans, "scan", lambda index: read.append(index) or FileScans.scan(scans, index))
    found = [scans.cleaned(index).points for index in (0, 0, 1, 0)]
    assert read == [0, 1, 0] and (found[0] == found[1]).all() and (found[0] == found[3]).all()
    assert not np.array_equal(found[0], found[2])


def test_polygons_become_fans():
    polygons = Polygons(np.array([4, 3, 2]), np.array([0, 1, 2, 3, 4, 5, 6, 7, 8]))
    assert polygons.fans().tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]


def test_a_scan_is_cleaned_of_what_cannot_be_used():
    points, faces = scans_of(ToyRig())[0]
    points[7] = np.nan
    dirty = np.concatenate([faces, [[3, 3, 4]]])
    found = Scan(points, dirty).cleaned()
    assert np.isfinite(found.points).all() and len(found.faces) == (~(faces == 7).any(axis=1)).sum()
    assert Scan(points[:49], None).cleaned() is None


def test_a_mesh_whose_faces_share_no_vertex_is_as_one_whose_faces_do():
    points, faces = scans_of(ToyRig())[0]
    apart = Scan(points[faces.reshape(-1)], np.arange(faces.size).reshape(-1, 3)).cleaned()
    assert len(apart.points) == len(points) and len(apart.faces) == len(faces)
    np.testing.assert_array_equal(apart.points[apart.faces], points[faces])
    assert not apart.surface(1.0, np.eye(3)).border_points.any()


def test_points_that_repeat_are_one():
    points = np.random.default_rng(0).normal(size=(60, 3))
    found = Scan(np.repeat(points, 20, axis=0), None, np.repeat(points, 20, axis=0)).cleaned()
    np.testing.assert_array_equal(found.points, points)
    np.testing.assert_array_equal(found.normals, points)
    assert Scan(np.repeat(points[:40], 20, axis=0)).cleaned() is None


@pytest.mark.parametrize("wrong", [0.0, np.nan])
def test_normals_without_a_direction_are_estimated(wrong):
    points = scans_of(ToyRig())[0][0]
    normals = points.copy()
    normals[3] = wrong
    surface = Scan(points, None, normals).cleaned().surface(1.0, np.eye(3))
    assert np.isfinite(surface.normals).all() and (surface.normals * points).sum(axis=1).min() > 0


def test_ragged_arrays_have_the_names_and_the_rate_of_other_arrays(tmp_path):
    points, faces = scans_of(ToyRig())[0]
    far = points + np.array([4e6, 0, 0])  # a float32 there has steps of 0.5 mm
    arrays = {"vertices": far, "offsets": [0, len(far)], "triangles": faces, "face_offsets": [0, len(faces)]}
    np.savez(tmp_path / "take.npz", **arrays, frame_rate="30000/1001", frame_numbers=[17.0])
    scans = RaggedArrays(tmp_path / "take.npz")
    assert scans.fps == pytest.approx(29.97, abs=1e-3) and scans.frame_numbers.tolist() == [17]
    np.testing.assert_array_equal(scans.scan(0).points, far)
    np.testing.assert_array_equal(scans.scan(0).faces, faces)


def test_still_gltf_files_are_scans_in_metres(run, tmp_path):
    for number, (points, faces) in enumerate(scans_of(ToyRig())):
        scene, place = trimesh.Scene(), trimesh.transformations.translation_matrix([0.1, 0.2, 0.3])
        half = len(faces) // 2
        scene.add_geometry(trimesh.Trimesh(points / 1000, faces[:half], process=False), node_name="left")
        moved = points / 1000 - place[:3, 3]
        scene.add_geometry(trimesh.Trimesh(moved, faces[half:], process=False), node_name="right", transform=place)
        scene.export(tmp_path / f"scan.{number}.glb")
    pattern = f"clip={tmp_path}/scan.%d.glb"
    done = run("invert", "rig=toy", f"--config-dir={CONF}", pattern, "out=got", "motion=keep", *NO_LOOK)
    assert done.code == 0 and "scans (GLB), 3 frames 0 to 2" in done.text and "unit m (as the file says)" in done.text
    rows = list(csv.DictReader((tmp_path / "got/scans.csv").read_text().splitlines()))
    assert all(float(row["scan_to_rig_mm"]) < 0.1 and float(row["scan_explained"]) > 0.95 for row in rows)
    alone = f"clip={tmp_path}/scan.0.glb"
    done = run("invert", "rig=toy", f"--config-dir={CONF}", alone, "out=no")
    assert done.code == 1 and "no animation in it" in done.text and "correspondence=surface" in done.text
    surface = ("correspondence=surface", "reading.mesh=left", "out=one", *NO_LOOK)
    assert run("invert", "rig=toy", f"--config-dir={CONF}", alone, *surface).code == 0
    done = run("wrap", "rig=toy", f"--config-dir={CONF}", f"scan={tmp_path}/got/curves.csv", "out=wrapped.obj")
    assert done.code == 1 and "ends in .obj, .ply" in done.text and "Traceback" not in done.text


@pytest.mark.parametrize("ending", ["obj", "ply"])
def test_a_folder_of_scans_is_a_clip_of_scans(run, tmp_path, ending):
    """It was read as one mesh in all frames, and refused with the advice to do what had been done."""
    (tmp_path / "s").mkdir()
    for number, (points, faces) in enumerate(scans_of(ToyRig())):
        kept = faces[: len(faces) - 20 * number]
        trimesh.Trimesh(points, kept).export(tmp_path / f"s/scan.{number}.{ending}")  # as many points as its faces use
    done = run("invert", "rig=toy", f"--config-dir={CONF}", "clip=s", "out=got", "motion=keep", *NO_LOOK)
    assert done.code == 0 and f"scans ({ending.upper()}), 3 frames 0 to 2" in done.text, done.text
    done = run("inspect", "s")
    assert done.code == 0 and "scans: meshes" in done.text, done.text
    trimesh.Trimesh(points, faces).export(tmp_path / "s/scan.0.stl")
    done = run("invert", "rig=toy", f"--config-dir={CONF}", "clip=s", "out=more", "correspondence=surface", *NO_LOOK)
    assert done.code == 1 and f"a folder of .{ending}, .stl files, expected one format" in done.text, done.text


def test_a_damaged_scan_is_refused_before_the_work_starts(run, tmp_path, monkeypatch):
    for number, (points, faces) in enumerate(scans_of(ToyRig())):
        trimesh.Trimesh(points, faces, process=False).export(tmp_path / f"scan.{number}.ply")
    (tmp_path / "scan.2.ply").write_bytes((tmp_path / "scan.2.ply").read_bytes()[:-500])
    monkeypatch.setattr(ScanSolver, "solve", None)  # no frame is solved
    clip = (f"clip={tmp_path}/scan.%d.ply", "correspondence=surface", "out=got", *NO_LOOK)
    done = run("invert", "rig=toy", f"--config-dir={CONF}", *clip)
    assert done.code == 1 and "scan.2.ply" in done.text and "truncated" in done.text and "Traceback" not in done.text, done.text
    assert not (tmp_path / "got").exists()
    monkeypatch.undo()
    done = run("invert", "rig=toy", f"--config-dir={CONF}", *clip, "frames.exclude=[2]", "motion=keep")
    assert done.code == 0, done.text


def test_objects_of_a_scan_are_chosen(tmp_path):
    lines = [f"v {number} 0 0" for number in range(9)]
    text = ["o hair", *lines[:3], "f 1 2 3", "o face", *lines[3:], "f 4 5 6", "f 7 8 9"]
    (tmp_path / "scan.obj").write_text("\n".join(text))
    scan = FileScans(str(tmp_path / "scan.obj"), ReadingOptions(mesh="face")).scan(0)
    assert scan.points[:, 0].tolist() == [3, 4, 5, 6, 7, 8] and scan.faces.tolist() == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize(("factor", "mm"), [(1.0, 1.0), (0.1, 10.0), (0.001, 1000.0)])
def test_the_unit_is_told_by_the_size(tmp_path, factor, mm):
    rig = ToyRig()
    write_ragged(tmp_path / "take.npz", [(factor * points, faces) for points, faces in scans_of(rig)])
    assert resolve_scan_units(RaggedArrays(tmp_path / "take.npz"), rig, ReadingOptions()).mm == mm


def test_scans_of_another_size_altogether_are_refused(tmp_path):
    rig = ToyRig()
    write_ragged(tmp_path / "take.npz", [(1e5 * points, faces) for points, faces in scans_of(rig)])
    with pytest.raises(InputError, match="reading.unit"):
        resolve_scan_units(RaggedArrays(tmp_path / "take.npz"), rig, ReadingOptions())


@pytest.mark.parametrize("clouds", [False, True])
def test_scans_are_inverted_from_the_command_line(run, tmp_path, clouds):
    rig = ToyRig()
    given = [(points, None if clouds else faces) for points, faces in scans_of(rig)]
    write_ragged(tmp_path / "take.npz", given, fps=30.0)
    done = run("invert", "rig=toy", f"--config-dir={CONF}", f"clip={tmp_path / 'take.npz'}", "out=got", "motion=keep")
    assert done.code == 0, done.text
    assert "correspondence=surface" in done.text
    rows = list(csv.DictReader((tmp_path / "got/curves.csv").read_text().splitlines()))
    for number, row in enumerate(rows):
        found = torch.tensor([float(row[control.name]) for control in rig.controls])
        apart = posed_mesh(rig, found)[0] - posed_mesh(rig, CONTROLS * (0.6 + 0.2 * number))[0]
        assert np.linalg.norm(apart, axis=1).mean() < (0.6 if clouds else 0.1)
    page = read_page(tmp_path / "got/look.html")
    points, _, distances = page.scans[0]
    assert len(page.scans) == 3 and len(points) == len(given[0][0]) and np.nanmedian(distances) < 0.2
    assert page.facts["labels"][0] == "scan to rig" and Image.open(tmp_path / "got/frames.png").size[0] > 500
    table = list(csv.DictReader((tmp_path / "got/scans.csv").read_text().splitlines()))
    assert all(float(row["scan_explained"]) > 0.95 for row in table)


def test_the_rigs_own_mesh_is_taken_by_its_vertices(run, tmp_path):
    rig = ToyRig()
    np.savez(tmp_path / "take.npz", vertices=np.stack([posed_mesh(rig, CONTROLS)[0]] * 3).astype(np.float32), fps=30.0)
    done = run(
        "invert",
        "rig=toy",
        f"--config-dir={CONF}",
        f"clip={tmp_path / 'take.npz'}",
        "out=got",
        "look.page=false",
        "look.sheet=false",
    )
    assert done.code == 0 and "read as the rig's own mesh, vertex by vertex" in done.text


def test_a_cloud_of_as_many_points_in_another_order_is_a_scan(run, tmp_path):
    rig = ToyRig(detail=3)
    points = posed_mesh(rig, CONTROLS)[0]
    np.save(tmp_path / "take.npy", np.random.default_rng(0).permutation(points)[None].astype(np.float32))
    given = (
        "invert",
        "rig=toy",
        "+rig.detail=3",
        f"--config-dir={CONF}",
        f"clip={tmp_path / 'take.npy'}",
        "motion=keep",
        *NO_LOOK,
    )
    done = run(*given, "out=got")
    assert done.code == 0 and "points without faces, as many as rig 'toy' has vertices, but in another order" in done.text
    assert "fitted by its surface" in done.text and "vertex by vertex" not in done.text
    done = run(*given, "out=no", "correspondence=vertices")
    assert done.code == 1 and "correspondence=surface fits a point cloud" in done.text


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["correspondence=nearest"], "expected auto or vertices or surface"),
        (["correspondence=surface", "method=network", "bundle=null"], "method=network"),
        (["prior=nowhere"], "nowhere"),
        (["controls.freeze=[bump0]"], "controls.freeze is not for correspondence=surface"),
    ],
)
def test_what_cannot_be_meant_ends_in_one_sentence(run, tmp_path, more, said):
    write_ragged(tmp_path / "take.npz", scans_of(ToyRig()), fps=30.0)
    done = run("invert", "rig=toy", f"--config-dir={CONF}", f"clip={tmp_path / 'take.npz'}", "out=got", *more)
    assert done.code == 1 and said in done.text and "Traceback" not in done.text
    assert not (tmp_path / "got").exists()


def test_what_was_read_is_said_as_it_is(run, tmp_path):
    lying = [(points[:, [0, 2, 1]] * [1, -1, 1] + [900, 0, 0], faces) for points, faces in scans_of(ToyRig())]
    write_ragged(tmp_path / "take.npz", lying, frame_numbers=np.array([10, 12, 16]))
    done = run("invert", "rig=toy", f"--config-dir={CONF}", f"clip={tmp_path / 'take.npz'}", "out=got")
    assert done.code == 0 and "3 frames 10 to 16 (1 missing: 14)" in done.text, done.text
