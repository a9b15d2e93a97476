"""What a path of scans holds, and which files are refused as clips of one mesh since they are scans."""

import numpy as np
import pytest
import trimesh

from riginv.clips.open import open_sequence
from riginv.clips.sequence import ScansError
from riginv.errors import InputError
from tests.support.clips import reading_options
from tests.support.scans import new_stage, usd_mesh, write_ragged
from tests.tracking.test_scan_scenes import CONF, RIG, one_cloud
from tests.tracking.test_scans import scans_of


def test_inspect_says_what_scans_a_path_holds(run, tmp_path):
    scans = scans_of(RIG)
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


def test_inspect_reads_a_clip_of_another_mesh_in_each_frame_as_scans(run, tmp_path):
    scans = scans_of(RIG)
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


def test_what_can_be_read_as_scans_is_refused_as_such(tmp_path):
    """As a clip of the rig; the class tells it, which comes out of the process that reads stages, too."""
    scans = scans_of(RIG)
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
