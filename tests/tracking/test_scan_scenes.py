"""Scans in the files of other programs: USD and Alembic whose topology changes, STL, a scene for each scan."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from riginv.clips.sequence import ScansError
from riginv.errors import InputError
from riginv.tracking.surfaces.scan_files import FileScans, MeshScans, open_scans, read_scan
from riginv.tracking.surfaces.scans import Scan
from tests.conftest import ROOT
from tests.support.clips import reading_options
from tests.support.scans import new_stage, usd_mesh, write_alembic
from tests.support.toys import ToyRig
from tests.tracking.test_scans import NO_LOOK, scans_of

CONF = f"--config-dir={ROOT / 'tests/conf'}"
RIG = ToyRig()


@pytest.fixture
def scans() -> list[tuple[np.ndarray, np.ndarray]]:
    return scans_of(RIG)


def one_cloud(folder: Path, points: np.ndarray) -> Path:
    """A stage with a point cloud that does not move."""
    from pxr import UsdGeom, Vt

    stage = new_stage(folder / "one cloud.usda")
    cloud = UsdGeom.Points.Define(stage, "/points")
    cloud.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    stage.Save()
    return folder / "one cloud.usda"


def closeness(scans, expected) -> None:
    for number, (points, faces) in enumerate(expected):
        found = scans.scan(number)
        np.testing.assert_allclose(found.points, points, atol=1e-4)
        np.testing.assert_array_equal(found.faces, faces)


def test_usd_whose_topology_changes_is_a_clip_of_scans(run, tmp_path, scans):
    path = tmp_path / "ragged take.usdc"
    stage = new_stage(path, metres=0.01, up="Z")
    for number, (points, faces) in enumerate(scans):
        usd_mesh(stage, points[:, [0, 2, 1]] * [1, -1, 1] / 10, faces, 101 + number)
    usd_mesh(stage, np.zeros((0, 3)), np.zeros((0, 3), int), 104)  # a lost frame
    stage.Save()
    done = run("invert", "rig=toy", CONF, f"clip={path}", "out=got", "motion=keep", *NO_LOOK)
    assert done.code == 0, done.text
    for said in (
        "4 frames 101 to 104",
        "30 fps",
        "unit cm (as the file says), z up (as the file says)",
        "fitted by its surface",
    ):
        assert said in done.text
    rows = (tmp_path / "got/scans.csv").read_text().splitlines()[1:]
    assert [float(row.split(",")[1]) < 0.15 for row in rows[:3]] == [True] * 3 and rows[3].endswith("no_scan")


def test_of_several_meshes_the_one_with_the_rigs_vertices_is_read(tmp_path):
    stage = new_stage(tmp_path / "take.usda")
    rest, faces = RIG.rest_vertices.numpy(), RIG.faces.numpy()
    for number in range(2):
        usd_mesh(stage, rest[::-1] + number, len(rest) - 1 - faces, number, path="/head")
        usd_mesh(stage, rest[:60] + number, faces[:1], number, path="/eyes")
    stage.Save()
    found = open_scans(str(tmp_path / "take.usda"), RIG, reading_options())
    assert len(found.scan(1).points) == len(rest)


def test_faces_of_left_handed_meshes_are_turned(tmp_path, scans):
    stage, (points, faces) = new_stage(tmp_path / "left.usda"), scans[0]
    from pxr import UsdGeom

    usd_mesh(stage, points, faces[:, ::-1])
    UsdGeom.Mesh.Get(stage, "/scan/head").CreateOrientationAttr("leftHanded")
    stage.Save()
    closeness(open_scans(str(tmp_path / "left.usda"), RIG, reading_options()), [(points, faces)])


def test_point_clouds_of_a_stage_are_scans(tmp_path, scans):
    stage = new_stage(tmp_path / "cloud.usda")
    from pxr import UsdGeom, Vt

    cloud = UsdGeom.Points.Define(stage, "/points")
    for number, (points, _) in enumerate(scans):
        cloud.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)), number)
    stage.Save()
    found = open_scans(str(tmp_path / "cloud.usda"), RIG, reading_options())
    assert [len(found.scan(number).points) for number in range(3)] == [len(points) for points, _ in scans]
    assert found.scan(0).faces is None
    scan, _ = read_scan(str(one_cloud(tmp_path, scans[0][0])), replace(reading_options(), fps=1.0), RIG)
    assert len(scan.points) == len(scans[0][0])


def test_clouds_of_equally_many_points_are_not_interpolated(tmp_path, scans):
    """Frame 1 has no sample: it holds that of frame 0, whose points are not those of frame 2 in another place."""
    stage = new_stage(tmp_path / "cloud.usda")
    from pxr import UsdGeom, Vt

    attribute, points = UsdGeom.Points.Define(stage, "/points").CreatePointsAttr(), scans[0][0].astype(np.float32)
    for time, order in ((0, slice(None)), (2, slice(None, None, -1)), (3, slice(None))):
        attribute.Set(Vt.Vec3fArray.FromNumpy(points[order]), time)
    stage.Save()
    found = open_scans(str(tmp_path / "cloud.usda"), RIG, reading_options())
    np.testing.assert_array_equal(found.scan(1).points, points)
    assert any("1 of 4 frames have no sample of their own: they hold the one before" in note for note in found.facts.notes)


def test_faces_that_lack_corners_in_a_later_frame_are_refused(tmp_path, scans):
    usd_geometry = pytest.importorskip("pxr.UsdGeom", reason="usd-core is not installed")
    stage = new_stage(tmp_path / "take.usda")
    for number, (points, faces) in enumerate(scans):
        usd_mesh(stage, points, faces, number)
    usd_geometry.Mesh.Get(stage, "/scan/head").GetFaceVertexIndicesAttr().Set(scans[2][1].ravel().tolist()[:-1], 2)
    stage.Save()
    found = open_scans(str(tmp_path / "take.usda"), RIG, reading_options())
    with pytest.raises(InputError, match=f"take.usda: its faces need {3 * len(scans[2][1])} corners and have"):
        found.scan(2)


def test_a_stage_with_a_skeleton_alone_is_no_scan(tmp_path):
    stage = new_stage(tmp_path / "bones.usda")
    from pxr import UsdSkel

    UsdSkel.Skeleton.Define(stage, "/skeleton").CreateJointsAttr(["hips"])
    stage.Save()
    with pytest.raises(InputError, match="bones.usda: .* It has a skeleton, .* leave out correspondence=surface") as refused:
        open_scans(str(tmp_path / "bones.usda"), RIG, reading_options())
    assert not isinstance(refused.value, ScansError)


def test_a_stage_for_each_scan_is_a_clip(run, tmp_path, scans):
    (tmp_path / "stills").mkdir()
    for number, (points, faces) in enumerate(scans):
        stage = new_stage(tmp_path / f"stills/scan.{number:04d}.usda")
        usd_mesh(stage, points, faces)
        stage.Save()
    for path in (tmp_path / "stills", tmp_path / "stills/scan.%04d.usda"):
        found = open_scans(str(path), RIG, reading_options())
        assert isinstance(found, FileScans) and found.unit_mm == 1 and found.up == "y" and len(found) == 3
    closeness(found, scans)


def test_alembic_whose_topology_changes_is_a_clip_of_scans(tmp_path, scans):
    write_alembic(tmp_path, *scans[0])
    found, expected = open_scans(str(tmp_path / "ragged.abc"), RIG, reading_options()), np.load(tmp_path / "expected.npz")
    assert isinstance(found, MeshScans) and found.fps == 25 and found.frame_numbers.tolist() == [1, 2, 3]
    closeness(
        found,
        [(expected[f"points{frame}"][:, [0, 2, 1]] * [1, 1, -1], expected[f"faces{frame}"]) for frame in (1, 2, 3)],
    )
    assert len({len(found.scan(number).points) for number in range(3)}) == 3


def test_stl_files_are_scans(run, tmp_path, scans):
    for number, (points, faces) in enumerate(scans):
        mesh = trimesh.Trimesh(points, faces, process=False)
        data = mesh.export(file_type="stl_ascii" if number else "stl")
        (tmp_path / f"scan.{number}.stl").write_bytes(data.encode() if isinstance(data, str) else data)
    done = run("invert", "bundle=nowhere", f"clip={tmp_path / 'scan.0.stl'}", "out=got")
    assert done.code == 1 and "Traceback" not in done.text
    found = open_scans(str(tmp_path / "scan.%d.stl"), RIG, reading_options())
    for number, (points, faces) in enumerate(scans):
        merged, expected = found.cleaned(number), Scan(points, faces).cleaned()
        assert len(merged.points) == len(expected.points)
        np.testing.assert_allclose(merged.points[merged.faces], expected.points[expected.faces], rtol=1e-5, atol=1e-4)


CUT = b"solid".ljust(80, b"\0") + b"\x02\0\0\0" + bytes(50)  # binary, of two triangles


@pytest.mark.parametrize("data", [b"", b"hello", bytes(80) + b"\xff\xff\0\0", b"solid x\nfacet normal 0 0", bytes(84), CUT])
def test_damaged_stl_files_are_refused(tmp_path, data):
    (tmp_path / "scan.stl").write_bytes(data)
    with pytest.raises(InputError, match="1 triangles, its header promises 2" if data is CUT else r"scan\.stl"):
        open_scans(str(tmp_path / "scan.stl"), RIG, reading_options()).scan(0)


def test_one_reader_serves_clips_and_neutrals(tmp_path, scans):
    points, faces = scans[0]
    arrays = {"points": points, "faces": faces, "offsets": [0, len(points)], "face_offsets": [0, len(faces)]}
    np.savez(tmp_path / "one.npz", **arrays)
    trimesh.Trimesh(points / 1000, faces, process=False).export(tmp_path / "one.glb")
    stage = new_stage(tmp_path / "one.usda")
    usd_mesh(stage, points, faces)
    stage.Save()
    for name in ("one.npz", "one.glb", "one.usda"):
        scan, units = read_scan(str(tmp_path / name), replace(reading_options(), fps=1.0), RIG)
        np.testing.assert_allclose(units.mm * scan.points, points, atol=1e-3)
    several = {**arrays, "points": np.tile(points, (2, 1)), "offsets": np.arange(3) * len(points)}
    np.savez(tmp_path / "two.npz", **several | {"faces": np.tile(faces, (2, 1)), "face_offsets": np.arange(3) * len(faces)})
    with pytest.raises(InputError, match="2 scans, expected one"):
        read_scan(str(tmp_path / "two.npz"), reading_options(), RIG)


def test_wrap_reads_a_stage_and_inches(run, tmp_path, scans):
    points, faces = scans[0]
    stage = new_stage(tmp_path / "neutral.usda")
    usd_mesh(stage, points, faces)
    stage.Save()
    done = run("wrap", "rig=toy", CONF, f"scan={tmp_path / 'neutral.usda'}", f"out={tmp_path / 'a.obj'}")
    assert done.code == 0 and "warning" not in done.text, done.text
    trimesh.Trimesh(points / 25.4, faces, process=False).export(tmp_path / "neutral.stl")
    done = run("wrap", "rig=toy", CONF, f"scan={tmp_path / 'neutral.stl'}", f"out={tmp_path / 'b.obj'}")
    assert done.code == 0 and "units of inches guessed" in done.text and "scale 0.99" in done.text, done.text
    (tmp_path / "c.png").write_bytes(b"a picture of mine")
    done = run("wrap", "rig=toy", CONF, f"scan={tmp_path / 'neutral.stl'}", f"out={tmp_path / 'c.obj'}", "unit=inch")
    assert done.code == 1 and "c.png is there already" in done.text and not (tmp_path / "c.obj").exists()
