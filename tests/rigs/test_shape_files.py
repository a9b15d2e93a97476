"""The files of a folder of shapes: read as they stand, or refused in one sentence."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from safetensors.numpy import save_file

from riginv.errors import InputError
from rigs.shapes import ShapesRig
from rigs.shapes.deltas import names_in, read_deltas
from rigs.shapes.mesh import read_sculpt
from tests.support.sculpts import FACES, FAN, POINTS, offset, write_folder, write_obj, write_ply

pytestmark = pytest.mark.usefixtures("own_cache")


SEAMS = "vt 0 0\nvt 1 1\nvn 0 0 1\n"


def test_an_obj_keeps_its_order_along_seams_and_whatever_else_stands_in_it(tmp_path):
    points = POINTS + offset(0)
    path = tmp_path / "a.obj"
    write_obj(path, points, corner="{0}/1/1")
    text = path.read_text().replace("f 4/1/1", "f -5/2/1").replace("f 1/1/1 2/1/1", "f 1//1 \\\r\n 2/2")
    path.write_text(
        "# a comment\r\nmtllib ä.mtl\no head\n" + SEAMS + text.replace("\nf", "\nusemtl skin\ns 1\nf", 1), "latin-1"
    )
    mesh = read_sculpt(path)
    np.testing.assert_allclose(mesh.vertices, points, atol=1e-8)
    assert [list(face) for face in np.split(mesh.faces.corners, np.cumsum(mesh.faces.sizes)[:-1])] == FACES
    assert mesh.faces.fans().tolist() == FAN


def test_an_obj_of_trimesh_and_one_with_colours_are_read_in_their_order(tmp_path):
    sphere = trimesh.creation.icosphere(2)
    sphere.export(tmp_path / "s.obj")
    sphere.visual.vertex_colors = np.full((len(sphere.vertices), 4), 100, np.uint8)
    sphere.export(tmp_path / "c.obj")
    for name in ("s.obj", "c.obj"):
        mesh = read_sculpt(tmp_path / name)
        np.testing.assert_allclose(mesh.vertices, sphere.vertices, atol=1e-7)
        np.testing.assert_array_equal(mesh.faces.fans(), sphere.faces)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_ply_keeps_its_order_in_text_and_binary(tmp_path, kind):
    points = POINTS + offset(1)
    write_ply(tmp_path / "a.ply", points, kind)
    mesh = read_sculpt(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.vertices, points)
    assert mesh.faces.fans().tolist() == FAN


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_ply_of_trimesh_is_read_in_its_order(tmp_path, encoding):
    sphere = trimesh.creation.icosphere(2)
    sphere.export(tmp_path / "s.ply", encoding=encoding)
    mesh = read_sculpt(tmp_path / "s.ply")
    np.testing.assert_allclose(mesh.vertices, sphere.vertices, atol=1e-6)
    np.testing.assert_array_equal(mesh.faces.fans(), sphere.faces)


def broken(folder: Path, **files: bytes | str) -> Path:
    for name, content in files.items():
        (folder / name.replace("__", ".")).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("files", "settings", "says"),
    [
        (
            {},
            {"neutral": "neutrall"},
            "no neutral named 'neutrall' among the 2 meshes there \\(a, neutral\\).*did you mean neutral",
        ),
        ({"a__ply": PLY}, {}, "a.obj and a.ply both hold a shape 'a'"),
        ({"b__obj": OBJ}, {}, "b.obj has 3 vertices, .*neutral.obj has 8"),
        ({"b__obj": ""}, {}, "b.obj: no vertices in it"),
        ({"b__obj": "v 1 nan 0\nf 1 1 1\n"}, {}, "1 vertices have NaN or infinite coordinates, the first is vertex 1 of 1"),
        ({"b__obj": "v 1 2 3\nv 1 2"}, {}, "line 2: found 'v 1 2', expected v X Y Z"),
        ({"b__obj": OBJ[:-2]}, {}, "face 1 has 2 corners"),
        ({"b__obj": OBJ.replace("f 1", "f 9")}, {}, "the faces use vertices 2 to 9, the file has vertices 1 to 3"),
        ({"b__obj": OBJ.replace("f 1", "f 0")}, {}, "the faces use vertices 0 to 3"),
        ({"b__obj": OBJ.replace("f 1", f"f {10**30}")}, {}, "damaged"),
        ({"b__ply": PLY + "end_header\n0 0 0\n1 1 1\n"}, {}, "promises 3 of 'vertex'"),
        ({"b__ply": PLY}, {}, "its header is truncated"),
        ({"b__ply": PLY.replace("ascii", "binary_little_endian") + "end_header\n" + "x" * 35}, {}, "promises 3 of 'vertex'"),
        ({"b__ply": PLY.replace("x 3", f"x {10**18}") + "end_header\n"}, {}, f"promises {10**18} of 'vertex'"),
        ({"b__ply": PLY.replace("float z", "float q") + "end_header\n" + "1 1 1\n" * 3}, {}, "x, y, z"),
        ({"b__npy": b"\x93NUMPY"}, {}, "b.npy: no NumPy array, or a damaged one"),
        ({"b__npz": b"PK\x03\x04 and no more"}, {}, "b.npz: no .npz, or a damaged one"),
        ({"b__safetensors": b"\xff" * 40}, {}, "b.safetensors: cannot be read as arrays of deltas"),
        ({}, {"include": ["jaw*"]}, "rig.include: 'jaw\\*' matches none of the 1 shapes"),
        ({}, {"exclude": ["*"]}, "leave no shape but the neutral"),
        ({}, {"deltas": ["x"]}, "rig.deltas: 'x' matches none"),
        ({}, {"combination": "sum"}, "rig.combination is 'sum', expected product or min"),
        ({}, {"unit_mm": 0}, "rig.unit_mm is 0"),
        ({}, {"include": "jaw*"}, "rig.include is 'jaw\\*', expected a list of globs"),
        ({}, {"deltas": "yes"}, "rig.deltas is 'yes', expected a list of globs"),
        ({}, {"corrective_names": "no"}, "rig.corrective_names is 'no', expected true or false"),
        ({}, {"unit_mm": float("nan")}, "rig.unit_mm is nan"),
    ],
)
def test_a_mistake_is_named_in_one_sentence(tmp_path, files, settings, says):
    folder = broken(write_folder(tmp_path / "rig", a=POINTS), **files)
    with pytest.raises(InputError, match=says) as caught:
        ShapesRig(str(folder), **settings)
    assert "\n" not in str(caught.value)


def test_a_mesh_with_other_faces_is_refused_with_both_files_and_counts(tmp_path):
    folder = write_folder(tmp_path / "rig", a=POINTS)
    write_obj(folder / "b.obj", POINTS, FAN)
    with pytest.raises(InputError, match="b.obj has 8 faces, .*neutral.obj has 4: "):
        ShapesRig(str(folder))
    write_obj(folder / "b.obj", POINTS, [FACES[0], FACES[2], FACES[1], FACES[3]])
    with pytest.raises(
        InputError, match="b.obj and .*neutral.obj both have 8 vertices and 4 faces, but face 2 joins.*1 5 8 6 "
    ):
        ShapesRig(str(folder))


@pytest.mark.parametrize("array", [np.zeros((7, 3)), np.zeros((8, 3), complex), np.full((8, 3), np.nan), np.array(["x"])])
def test_arrays_that_are_no_deltas_are_refused(tmp_path, array):
    folder = write_folder(tmp_path / "rig", a=POINTS)
    np.savez(folder / "table.npz", b=array)
    with pytest.raises(InputError, match="table.npz: .*'b'"):
        ShapesRig(str(folder))
    assert ShapesRig(str(folder), exclude=["b"]).control_names == ("a",)


def test_a_table_may_hold_the_neutral_and_other_things_where_they_are_left_out(tmp_path):
    folder = write_folder(tmp_path / "rig", a=POINTS)
    np.savez(folder / "table.npz", b=offset(0), neutral=POINTS, poseNames=np.array(["b"]))
    with pytest.raises(InputError, match="neutral.obj and table.npz both hold a shape 'neutral'"):
        ShapesRig(str(folder))
    assert ShapesRig(str(folder), exclude=["neutral", "poseNames"]).control_names == ("a", "b")


def test_arrays_of_objects_are_not_unpickled(tmp_path):
    folder = write_folder(tmp_path / "rig", a=POINTS)
    np.save(folder / "b.npy", np.array([{"code": "run"}]), allow_pickle=True)
    with pytest.raises(InputError, match="b.npy: it holds object"):
        ShapesRig(str(folder))


def test_folders_that_hold_no_rig_are_named(tmp_path, run):
    with pytest.raises(InputError, match="no such folder"):
        ShapesRig(str(tmp_path / "nowhere"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="it is empty"):
        ShapesRig(str(tmp_path / "empty"))
    (tmp_path / "empty/scene.fbx").write_text("")
    with pytest.raises(InputError, match="its 1 files are scene.fbx"):
        ShapesRig(str(tmp_path / "empty"))
    with pytest.raises(InputError, match="neutral.obj is the only shape there"):
        ShapesRig(str(write_folder(tmp_path / "lonely")))
    write_obj(tmp_path / "lonely/neutral.obj", POINTS, faces=[])
    write_obj(tmp_path / "lonely/a.obj", POINTS, faces=[])
    with pytest.raises(InputError, match="vertices but no faces"):
        ShapesRig(str(tmp_path / "lonely"))
    outcome = run("check", "rig=shapes")
    assert outcome.code == 1 and "rig.folder must be given" in outcome.text


def test_every_cut_of_a_file_is_either_refused_or_whole(tmp_path):
    """A file that was cut off anywhere is never half-read: it is refused, or only spaces are missing."""
    folder = write_folder(tmp_path / "rig")
    for name, write in (("a.obj", write_obj), ("a.ply", lambda path, points: write_ply(path, points, "binary_little_endian"))):
        write(folder / name, POINTS)
        whole = (folder / name).read_bytes()
        for length in range(0, len(whole) - 1, 7):
            (folder / name).write_bytes(whole[:length])
            with pytest.raises(InputError):
                ShapesRig(str(folder))
        (folder / name).unlink()


def test_no_damage_to_a_file_gets_past_the_readers(tmp_path):
    """Bytes changed and cut off at random: either the file still reads, or one sentence says that it does not."""
    write_obj(tmp_path / "a.obj", POINTS)
    write_ply(tmp_path / "t.ply", POINTS, "ascii")
    write_ply(tmp_path / "b.ply", POINTS, "binary_big_endian")
    np.save(tmp_path / "n.npy", offset(0))
    np.savez(tmp_path / "z.npz", b=offset(0))
    np.savez_compressed(tmp_path / "c.npz", b=offset(0))
    save_file({"b": offset(0)}, tmp_path / "s.safetensors")
    draw, outcomes = np.random.default_rng(0), set()
    for path in sorted(tmp_path.iterdir()):
        whole = path.read_bytes()
        for _ in range(200):
            damaged = bytearray(whole)
            for place in draw.integers(len(whole), size=draw.integers(1, 5)):
                damaged[place] = draw.integers(256)
            path.write_bytes(damaged[: draw.integers(len(whole)) if draw.random() < 0.3 else None])
            try:
                if path.suffix in (".obj", ".ply"):
                    assert np.isfinite(read_sculpt(path).vertices).all()
                else:
                    assert all(read_deltas(path, name, len(POINTS)).shape == POINTS.shape for name in names_in(path))
                outcomes.add((path.name, "read"))
            except InputError as error:
                assert "\n" not in str(error)
                outcomes.add((path.name, "refused"))
    assert len(outcomes) == 14
