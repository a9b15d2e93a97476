"""OBJ as programs write it: several objects, any style of lines, any encoding; read by clips and rigs alike."""

import re
import time
from pathlib import Path

import numpy as np
import pytest

from riginv.clips.open import open_sequence
from riginv.clips.options import ReadingOptions
from riginv.clips.topology import check_topology
from riginv.errors import InputError
from riginv.meshes.obj import ObjMesh
from riginv.meshes.polygons import Polygons
from rigs.shapes import ShapesRig
from tests.support.clips import performance, write_npz
from tests.support.sculpts import FACES, FAN, POINTS, offset, write_folder
from tests.support.toys import ToyRig


def text_of(points: np.ndarray = POINTS, faces=FACES, vertex: str = "v {} {} {}", corner: str = "{}") -> str:
    lines = [vertex.format(*point) for point in points]
    return "\n".join([*lines, *("f " + " ".join(corner.format(index + 1) for index in face) for face in faces)]) + "\n"


def listed(polygons: Polygons) -> list[list[int]]:
    return [polygons.face(number).tolist() for number in range(len(polygons))]


STYLES = {
    "plain": text_of(),
    "a comment first": "# made by a test\n\n" + text_of(),
    "weights": text_of(vertex="v {} {} {} 1.0"),
    "colours": text_of(vertex="v {} {} {} 0.5 0.5 0.5"),
    "wide": text_of(vertex="v   {}\t{}  {}  "),
    "indented": text_of(vertex="  v {} {} {}").replace("\nf", "\n\tf"),
    "tabs": text_of(vertex="v\t{}\t{}\t{}").replace("f ", "f\t"),
    "comments behind": text_of(vertex="v {} {} {} # a vertex").replace("f 1 2", "f 1 2 \\\n"),
    "windows": text_of(corner="{}/1/1").replace("\n", "\r\n"),
    "old Macs": text_of().replace("\n", "\r"),
    "all corners": text_of(corner="{0}/{0}/{0}"),
    "normals alone": text_of(corner="{}//3"),
    "textures alone": text_of(corner="{}/7"),
    "old keyword": text_of().replace("f ", "fo "),
    "counted from behind": text_of(faces=[[index - 9 for index in face] for face in FACES]),
    "no last line feed": text_of()[:-1],
    "faces first": "".join(sorted(text_of().splitlines(keepends=True), key=lambda line: line[0])),
    "values of vt": "\n".join(f"vt 0 0\nvn 0 0 1\n{line}" for line in text_of().splitlines()),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize("style", STYLES)
def test_vertices_and_faces_of_every_style(style, encoding):
    text = f"# ä\n{STYLES[style]}" if style != "old Macs" else STYLES[style]
    for data in (text.encode(encoding), STYLES[style].encode(encoding)):
        mesh = ObjMesh(Path("a.obj"), data)
        np.testing.assert_array_equal(mesh.points, POINTS)
        assert listed(mesh.polygons()) == FACES


def several_objects(points: np.ndarray, faces: np.ndarray, cuts: list[int]) -> str:
    """A mesh in objects, each with its vertices and its faces, as Blender writes it; faces across two are of the latter."""
    text, ends = "mtllib a.mtl\n", [*cuts, len(points)]
    for number, (start, end) in enumerate(zip([0, *cuts], ends)):
        own = [face for face in faces if start <= max(face) < end]
        lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points[start:end]]
        text += "\n".join([f"o part {number}", *lines, "vn 0 0 1", "usemtl skin", "s 1"]) + "\n"
        text += "".join("f " + " ".join(f"{index + 1}//1" for index in face) + "\n" for face in own)
    return text


def test_several_objects_are_one_mesh_and_said_so(tmp_path):
    rig = ToyRig(detail=1)
    meshes, faces = performance(rig, 3), rig.faces.numpy()
    for number, points in enumerate(meshes):
        (tmp_path / f"f.{number}.obj").write_text(several_objects(points, faces, [10, 30]))
    sequence = open_sequence(str(tmp_path), rig, ReadingOptions())
    assert sequence.facts.meshes == ("part 0", "part 1", "part 2") and "3 objects in f.0.obj" in sequence.facts.notes[0]
    assert check_topology(sequence, rig) == "" and np.abs(sequence.read(0, 3) - meshes).max() < 1e-5
    (tmp_path / "f.1.obj").write_text(several_objects(meshes[1], faces[:, ::-1], [10, 30]))
    with pytest.raises(InputError, match="f.1.obj: its 80 faces are not the 80 of f.0.obj"):
        sequence.read(0, 3)


@pytest.mark.parametrize("asked", ["head", ["head"], ["left eye", "head"]])
def test_an_object_is_chosen_by_name(asked, tmp_path):
    rig = ToyRig(detail=1)
    meshes, faces = performance(rig, 3), rig.faces.numpy()
    eye = meshes[0, :5]
    for number, points in enumerate(meshes):
        both = several_objects(np.concatenate([eye, points]), [*(faces + 5), [0, 1, 2]], [5])
        (tmp_path / f"f.{number}.obj").write_text(both.replace("part 0", "left eye").replace("part 1", "head"))
    sequence = open_sequence(str(tmp_path), rig, ReadingOptions(mesh=asked))
    found = sequence.read(0, 3)
    if asked == ["left eye", "head"]:
        assert sequence.facts.meshes == ("left eye", "head") and found.shape[1] == 47 and len(sequence.faces) == 81
        return
    assert sequence.facts.meshes == ("head",) and sequence.facts.other_meshes == ("left eye",)
    assert check_topology(sequence, rig) == "" and np.abs(found - meshes).max() < 1e-5
    with pytest.raises(InputError, match="reading.mesh names 'nose', which is no object there; its objects: left eye, head"):
        open_sequence(str(tmp_path), rig, ReadingOptions(mesh="nose"))


@pytest.mark.parametrize("name", ["a.ply", "a.npy", "a.mdd", "a.pc2", "a.obj"])
def test_what_a_format_has_no_names_for_is_passed_over_and_said(name, tmp_path):
    from tests.fuzz.readers import CLIPS, toy

    path = CLIPS[name[2:]](tmp_path / name, performance(toy(), 2), toy().faces.numpy())
    if name == "a.obj":
        path.write_text(path.read_text().replace("o head", ""))
    notes = open_sequence(str(path), toy(), ReadingOptions(mesh="head", animation=2)).facts.notes
    assert any("reading.mesh=head was ignored" in note for note in notes)
    assert any("reading.animation=2 was ignored" in note for note in notes)


@pytest.mark.parametrize(
    "faces, says",
    [
        ("f 1 2 x", "line 9: found 'f 1 2 x'"),
        ("f 1 2 /3", "line 9: found 'f 1 2 /3'"),
        ("f 1 2 3.5", "line 9: found 'f 1 2 3.5'"),
        ("f 1 2 1e1", "line 9: found 'f 1 2 1e1'"),
        ("f 1 2 9", "a face uses vertex 8, expected 0 to 7"),
        ("f 1 2 0", "a face uses vertex -1, expected 0 to 7"),
        (f"f 1 2 {10**25}", "a face uses vertex 1000"),
    ],
)
def test_faces_that_are_none_are_named(faces, says, tmp_path):
    for others in ("", "f 1 2 -1\n"):  # all at once, or line by line
        (tmp_path / "a.obj").write_text(text_of(faces=[]) + faces + "\n" + others)
        with pytest.raises(InputError, match=f"a.obj.*: {says}" if "line" not in says else f"a.obj, {says}"):
            open_sequence(str(tmp_path / "a.obj"), ToyRig(), ReadingOptions())


@pytest.mark.parametrize("line", ["v4 5 6", "v4 5 nan", "vt 4 5", "vx 4 5 6", "v"])
def test_what_only_looks_like_a_vertex_is_none(line):
    data = f"v 1 2 3\n{line}\nv 7 8 9\n".encode()
    np.testing.assert_array_equal(ObjMesh(Path("a.obj"), data).points, [[1, 2, 3], [7, 8, 9]])


def test_rigs_and_clips_read_the_same(tmp_path, own_cache):
    write_folder(tmp_path / "rig", smile=POINTS + offset(1))
    for name, style in (("frown", "comments behind"), ("blink", "windows"), ("jaw", "faces first")):
        (tmp_path / f"rig/{name}.obj").write_text(STYLES[style].replace("3.0 1.0", "3.5 1.0"), newline="")
    rig = ShapesRig(str(tmp_path / "rig"))
    assert rig.faces.tolist() == FAN
    moved = np.zeros((8, 3))
    moved[2, 0] = 0.5
    for name in ("frown", "blink", "jaw"):
        np.testing.assert_allclose(rig.basis[rig.control_names.index(name)], moved, atol=1e-6)
        clip = open_sequence(str(tmp_path / f"rig/{name}.obj"), rig, ReadingOptions())
        np.testing.assert_allclose(clip.read(0, 1)[0], POINTS + moved, atol=1e-6)


def test_a_neutral_of_several_objects_says_so(tmp_path, own_cache):
    folder = write_folder(tmp_path / "rig", smile=POINTS)
    path = folder / "neutral.obj"
    path.write_text("o head\n" + path.read_text().replace("\nf", "\no teeth\nf", 1))
    assert ShapesRig(str(folder)).notes == ("2 objects in neutral.obj (head, teeth) were read as one mesh, in this order.",)


@pytest.mark.slow  # a speed, which a busy machine does not show
def test_unusual_files_are_read_fast_too(face):
    """Objects between vertices, NaN, Fortran's exponents: not line by line, which goes at 3 MB a second."""
    plain = several_objects(face.rest_vertices.numpy(), face.faces.numpy(), [2000, 5000])
    for text in (plain, plain.replace("v 0", "v 1.#IND00 0"), re.sub(r"(\.\d+)$", r"\1D+00", plain, flags=re.MULTILINE)):
        data, began = text.encode(), time.process_time()
        assert len(ObjMesh(Path("a.obj"), data).points) == 8447
        assert len(data) / 1e6 / (time.process_time() - began) > 8


def test_an_array_of_an_npz_is_chosen_by_name(tmp_path):
    rig = ToyRig(detail=1)
    meshes = performance(rig, 3)
    write_npz(tmp_path / "a.npz", meshes, rig.faces.numpy())
    np.savez(tmp_path / "b.npz", raw=meshes, smooth=meshes + 1, normals=meshes[:, :, :2])
    with pytest.raises(
        InputError,
        match="no array of vertices.*found raw, smooth, and any of these 2 could be it: choose one with reading.mesh=NAME",
    ):
        open_sequence(str(tmp_path / "b.npz"), rig, ReadingOptions())
    sequence = open_sequence(str(tmp_path / "b.npz"), rig, ReadingOptions(mesh="smooth"))
    assert sequence.facts.meshes == ("smooth",) and sequence.facts.other_meshes == ("raw",)
    with pytest.raises(InputError, match="reading.mesh names rough, expected one of its arrays: raw, smooth, normals"):
        open_sequence(str(tmp_path / "b.npz"), rig, ReadingOptions(mesh="rough"))
