"""Scans in the files of other programs: USD and Alembic whose topology changes, STL, a scene for each scan."""

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from riginv.clips.open import open_sequence
from riginv.clips.sequence import ScansError
from riginv.errors import InputError
from riginv.tracking.surfaces.scan_files import FileScans, MeshScans, open_scans, read_scan
from riginv.tracking.surfaces.scans import Scan
from tests.conftest import ROOT
from tests.support.blends import blender
from tests.support.clips import reading_options
from tests.support.scans import write_ragged
from tests.support.toys import ToyRig
from tests.tracking.test_scans import NO_LOOK, scans_of

CONF = f"--config-dir={ROOT / 'tests/conf'}"
RIG = ToyRig()
MAKE = """
import os, sys, bpy, numpy as np
data = np.load(sys.argv[-1])
folder = os.path.dirname(sys.argv[-1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps, scene.frame_start, scene.frame_end = 25, 1, 3
points = data["points"]
mesh = bpy.data.meshes.new("head")
mesh.from_pydata((points[:, [0, 2, 1]] * [1, -1, 1]).tolist(), [], data["faces"].tolist())
head = bpy.data.objects.new("head", mesh)
scene.collection.objects.link(head)
less = head.modifiers.new("less", "DECIMATE")
for frame, ratio in enumerate((1.0, 0.8, 0.6), start=1):
    less.ratio = ratio
    less.keyframe_insert("ratio", frame=frame)
bpy.ops.wm.alembic_export(filepath=folder + "/ragged.abc", start=1, end=3, as_background_job=False)
found = {}
for frame in (1, 2, 3):
    scene.frame_set(frame)
    shown = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    found[f"points{frame}"] = np.array([vertex.co[:] for vertex in shown.vertices])
    found[f"faces{frame}"] = np.array([face.vertices[:] for face in shown.polygons])
np.savez(folder + "/expected.npz", **found)
os._exit(0)
"""


@pytest.fixture
def scans() -> list[tuple[np.ndarray, np.ndarray]]:
    return scans_of(RIG)


def new_stage(path: Path, **metadata):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, metadata.get("metres", 0.001))
    UsdGeom.SetStageUpAxis(stage, metadata.get("up", "Y"))
    stage.SetTimeCodesPerSecond(30)
    return stage


def usd_mesh(stage, points, faces, time=None, path="/scan/head") -> None:
    """The mesh of a stage at a time."""
    from pxr import Usd, UsdGeom, Vt

    mesh, at = UsdGeom.Mesh.Define(stage, path), Usd.TimeCode.Default() if time is None else time
    mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(np.asarray(points, np.float32)), at)
    mesh.CreateFaceVertexCountsAttr().Set([3] * len(faces), at)
    mesh.CreateFaceVertexIndicesAttr().Set(faces.ravel().tolist(), at)


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


def one_cloud(folder: Path, points: np.ndarray) -> Path:
    """A stage with a point cloud that does not move."""
    from pxr import UsdGeom, Vt

    stage = new_stage(folder / "one cloud.usda")
    cloud = UsdGeom.Points.Define(stage, "/points")
    cloud.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    stage.Save()
    return folder / "one cloud.usda"


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
    np.savez(tmp_path / "mesh.npz", points=scans[0][0], faces=scans[0][1])
    (tmp_path / "make.py").write_text(MAKE)
    command = [blender(), str(tmp_path / "make.py"), str(tmp_path / "mesh.npz")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
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


def test_inspect_says_what_scans_a_path_holds(run, tmp_path, scans):
    write_ragged(tmp_path / "meshes.npz", scans)
    clouds = [(points, None) for points, _ in scans]
    write_ragged(tmp_path / "clouds.npz", clouds, normals=np.concatenate([points for points, _ in scans]), fps=25.0)
    (tmp_path / "folder é (1)").mkdir()
    for number, (points, faces) in enumerate(scans):
        trimesh.Trimesh(points / 1000, faces, process=False).export(tmp_path / f"folder é (1)/scan.{number}.glb")
    expected = {
        "meshes.npz": ("kind     scans: meshes", "940 to 960 a frame", "of the faces", "unit     not known", "3 frames 0 to 2"),
        "clouds.npz": ("kind     scans: point clouds", "482 in each frame", "in the file", "25 frames a second"),
        "folder é (1)": ("scans (GLB)", "unit     m (as the file says)"),
    }
    for name, words in expected.items():
        done = run("inspect", str(tmp_path / name))
        assert done.code == 0 and all(word in done.text for word in words), done.text
    done = run("inspect", str(tmp_path / "meshes.npz"), "rig=toy", CONF)
    assert done.code == 0 and "unit     mm (guessed)" in done.text


def test_inspect_reads_a_clip_of_another_mesh_in_each_frame_as_scans(run, tmp_path, scans):
    stage = new_stage(tmp_path / "take.usdc")
    for number, (points, faces) in enumerate(scans):
        usd_mesh(stage, points, faces, number)
    usd_mesh(stage, np.zeros((0, 3)), np.zeros((0, 3), int), 3)
    stage.Save()
    done = run("inspect", str(tmp_path / "take.usdc"))
    assert done.code == 0 and "kind            scans: meshes" in done.text and "1 frame: 3" in done.text, done.text
    for number, (points, faces) in enumerate(scans):
        trimesh.Trimesh(points, faces, process=False).export(tmp_path / f"scan.{number}.ply")
    done = run("inspect", str(tmp_path / "scan.%d.ply"), "rig=toy", CONF)
    words = ("kind     scans: meshes", "unit     mm (guessed)", "rig toy", "correspondence=surface")
    assert done.code == 0 and all(word in done.text for word in words), done.text


def test_what_can_be_read_as_scans_is_refused_as_such(tmp_path, scans):
    """As a clip of the rig; the class tells it, which comes out of the process that reads stages, too."""
    for number, (points, faces) in enumerate(scans):
        trimesh.Trimesh(points[number:], faces[:1], process=False).export(tmp_path / f"scan.{number}.ply")
    trimesh.Trimesh(*scans[0], process=False).export(tmp_path / "still.glb")
    stage = new_stage(tmp_path / "clip.usda")
    usd_mesh(stage, *scans[0], 0)
    usd_mesh(stage, scans[1][0][1:], scans[1][1], 1)
    stage.Save()
    for path in ("scan.%d.ply", "still.glb", "clip.usda", one_cloud(tmp_path, scans[0][0])):
        with pytest.raises(ScansError, match="correspondence=surface"):
            open_sequence(str(tmp_path / path), None, reading_options()).read(0, 2)
    (tmp_path / "no.usda").write_text("#usda 1.0\n")
    with pytest.raises(InputError, match="expected one mesh, and it has none") as refused:
        open_sequence(str(tmp_path / "no.usda"), None, reading_options())
    assert not isinstance(refused.value, ScansError)


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
