"""PLY as programs write it, whatever stands before, between and behind the vertices and faces: read by clips and rigs alike."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from riginv.clips.open import open_sequence
from riginv.clips.options import ReadingOptions
from riginv.clips.topology import check_topology
from riginv.errors import InputError
from riginv.meshes.ply import PlyMesh
from rigs.shapes import ShapesRig
from rigs.shapes.mesh import read_sculpt
from tests.support.clips import performance
from tests.support.ply_writer import Written, faces, ply, vertices
from tests.support.sculpts import FACES, FAN, POINTS, offset
from tests.support.toys import ToyRig

FORMATS = ("ascii", "binary_little_endian", "binary_big_endian")
EDGES = Written("edge", ("int vertex1", "int vertex2", "uchar crease"), [(0, 1, 0), (1, 2, 9), (2, 3, 0)])
MATERIALS = Written("material", ("uchar red", "list uchar float more"), [(1, [0.5]), (2, []), (3, [1.5, 2.5, 3.5])])
POINTS_F = POINTS.astype(np.float32).astype(np.float64)
XYZ = ("float x", "float y", "float z")
SEVEN = ("float nx", "float x", "uchar red", "double y", "float z", "int flags", "short group")
SHAPES = {
    "plain": [vertices(POINTS), faces(FACES)],
    "edges before faces": [vertices(POINTS), EDGES, faces(FACES)],
    "edges before all": [EDGES, vertices(POINTS), faces(FACES)],
    "lists before faces": [vertices(POINTS), MATERIALS, faces(FACES)],
    "lists before all": [MATERIALS, vertices(POINTS), EDGES, faces(FACES), MATERIALS],
    "faces before vertices": [faces(FACES), vertices(POINTS)],
    "faces, edges, vertices": [faces(FACES), EDGES, vertices(POINTS), MATERIALS],
    "triangles before vertices": [faces(FAN), vertices(POINTS)],
    "doubles": [vertices(POINTS, ("double z", "double x", "double y")), faces(FACES)],
    "among other properties": [vertices(POINTS, SEVEN), faces(FACES)],
    "a list at each vertex": [vertices(POINTS, ("list uchar int tags", *XYZ), tags=[4, 5]), faces(FACES)],
    "lists of any length at vertices": [
        Written("vertex", ("list ushort float w", *XYZ), [([1.0] * n, *point) for n, point in enumerate(POINTS)]),
        faces(FACES),
    ],
    "vertex_index": [vertices(POINTS), faces(FACES, ("list uint8 uint32 vertex_index",))],
    "lengths of 4 bytes": [vertices(POINTS), faces(FACES, ("list int short vertex_indices",))],
    "texture coordinates before corners": [
        vertices(POINTS),
        faces(
            FACES,
            ("int material", "list uchar float texcoord", "list uchar int vertex_indices", "uchar flags"),
            texcoord=[0.5, 0.25],
        ),
    ],
    "an empty element": [vertices(POINTS), Written("edge", ("int a",), []), faces(FACES)],
    "an element of nothing": [Written("extra", (), []), vertices(POINTS), faces(FACES)],
}


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("shape", SHAPES)
def test_vertices_and_faces_are_read_wherever_they_stand(shape, form):
    data = ply(SHAPES[shape], form)
    mesh = PlyMesh(Path("a.ply"), data)
    np.testing.assert_array_equal(mesh.points, POINTS_F)
    polygons = mesh.polygons()
    assert [polygons.face(number).tolist() for number in range(len(polygons))] == (FAN if "triangles" in shape else FACES)
    if form != "ascii":
        for end in range(len(data) - 60, len(data)):
            with pytest.raises(InputError, match="truncated|damaged"):  # cut off
                PlyMesh(Path("a.ply"), data[:end]).polygons()


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("line", ["\n", "\r\n", "\r"])
def test_headers_end_their_lines_in_any_way(line, form):
    more = ("comment element vertex 3", "comment end_header", "obj_info made by a test", "comment")
    points = np.array([[10.0, 13.0, 10.5]] * 8)  # bytes of line feeds
    mesh = PlyMesh(
        Path("a.ply"),
        ply([vertices(points, ("char x", "float y", "float z")), faces(FACES)], form, line, more),
    )
    np.testing.assert_array_equal(mesh.points, points)
    assert len(mesh.polygons()) == len(FACES)


@pytest.mark.parametrize("form", FORMATS)
def test_strips_of_triangles_are_read_as_triangles(form):
    strips = [[0, 1, 2, 3, -1, 4, 5, 6], [7, 6, 6, 5, 4]]
    data = ply([vertices(POINTS), Written("tristrips", ("list int int vertex_indices",), [[strip] for strip in strips])], form)
    expected = [[0, 1, 2], [2, 1, 3], [4, 5, 6], [6, 5, 4]]
    found = PlyMesh(Path("a.ply"), data).polygons()
    assert [found.face(number).tolist() for number in range(len(found))] == expected


def strip_of(triangles: np.ndarray) -> list[int]:
    """One strip of separate triangles, parted by -1."""
    return [int(corner) for face in triangles for corner in (*face, -1)]


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("kind", ["edges", "faces first", "strips", "lists"])
def test_clips_in_another_order_are_refused_whatever_stands_before_the_faces(kind, form, tmp_path):
    rig = ToyRig(detail=1)
    triangles, meshes = rig.faces.numpy(), performance(rig, 3)
    order = np.random.default_rng(0).permutation(len(meshes[0]))
    for folder, points, corners in (("right", meshes, triangles), ("wrong", meshes[:, order], np.argsort(order)[triangles])):
        (tmp_path / folder).mkdir()
        for number, mesh in enumerate(points):
            face = (
                Written("tristrips", ("list int int vertex_indices",), [[strip_of(corners)]])
                if kind == "strips"
                else faces(corners)
            )
            between = {"edges": [EDGES], "lists": [MATERIALS]}.get(kind, [])
            elements = [face, vertices(mesh)] if kind == "faces first" else [vertices(mesh), *between, face]
            (tmp_path / folder / f"p_{number:03d}.ply").write_bytes(ply(elements, form))
    right, wrong = (open_sequence(str(tmp_path / folder), rig, ReadingOptions()) for folder in ("right", "wrong"))
    assert check_topology(right, rig) == "" and np.abs(right.read(0, 3) - meshes).max() < 1e-4
    with pytest.raises(InputError, match="edges of the clip are none of the rig's"):
        check_topology(wrong, rig)


def test_an_element_that_changes_between_frames_does_not_hide_other_faces(tmp_path):
    rig = ToyRig(detail=1)
    triangles, meshes = rig.faces.numpy(), performance(rig, 3)
    for number, mesh in enumerate(meshes):
        stamps = Written("stamp", ("int frame",), [[number]])
        (tmp_path / f"p.{number}.ply").write_bytes(ply([stamps, vertices(mesh), faces(triangles)], "binary_little_endian"))
    sequence = open_sequence(str(tmp_path), rig, ReadingOptions())
    assert np.abs(sequence.read(0, 3) - meshes).max() < 1e-4
    (tmp_path / "p.2.ply").write_bytes(ply([vertices(meshes[2]), faces(triangles[::-1])], "binary_little_endian"))
    with pytest.raises(InputError, match="p.2.ply: its 80 faces are not the 80 of p.0.ply"):
        sequence.read(0, 3)


@pytest.mark.parametrize("form", FORMATS)
def test_rigs_and_clips_read_the_same(form, tmp_path, own_cache):
    elements = [EDGES, vertices(POINTS, ("double x", "double y", "double z")), MATERIALS, faces(FACES)]
    for name, points in {"neutral": POINTS, "smile": POINTS + offset(1)}.items():
        elements[1] = vertices(points, ("double x", "double y", "double z"))
        (tmp_path / f"{name}.ply").write_bytes(ply(elements, form))
    rig = ShapesRig(str(tmp_path))
    np.testing.assert_allclose(rig.basis[0].numpy(), offset(1), atol=1e-6)
    assert rig.faces.tolist() == FAN
    clip = open_sequence(str(tmp_path / "smile.ply"), rig, ReadingOptions())
    assert check_topology(clip, rig) == ""
    np.testing.assert_array_equal(clip.read(0, 1)[0], read_sculpt(tmp_path / "smile.ply").vertices.astype(np.float32))


def test_text_may_break_its_lines_anywhere_but_lose_no_number():
    data = ply([vertices(POINTS), EDGES, faces(FACES)])
    head, _, body = data.partition(b"end_header\n")
    for other in (body.replace(b" ", b"\n"), b"\n\n" + body, body.replace(b"\n", b" \t\r\n"), body.replace(b"\n", b" ")):
        mesh = PlyMesh(Path("a.ply"), head + b"end_header\n" + other)
        assert (mesh.points == POINTS_F).all() and len(mesh.polygons()) == 4
    words = body.split()
    for number in range(len(words)):
        for changed in (words[:number] + words[number + 1 :], [*words[:number], b"9", *words[number:]]):
            with pytest.raises(InputError):
                PlyMesh(Path("a.ply"), head + b"end_header\n" + b" ".join(changed)).polygons()


@pytest.mark.parametrize(
    "data, says",
    [
        (b"", "no PLY file"),
        (b"plx\nformat ascii 1.0\nend_header\n", "no PLY file"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n1\n", "no PLY file"),
        (ply([vertices(POINTS)]).replace(b"vertex 8", b"vertex -8"), "no PLY file"),
        (ply([vertices(POINTS)]).replace(b"property float z", b"propXrty float z\nproperty float z"), "no PLY file"),
        (ply([Written("extra", (), [(), ()]), vertices(POINTS)], FORMATS[1]), "no PLY file"),
        (ply([faces(FACES)]), "no element 'vertex'"),
        (ply([vertices(POINTS, ("float x", "float y"))]), r"vertices of \['x', 'y'\], expected x, y, z"),
        (ply([vertices(POINTS, ("float x", "float y", "float z", "float x"))]), "expected x, y, z"),
        (ply([Written("vertex", ("list uchar float x", "float y", "float z"), [([1.0], 1.0, 1.0)])]), "a number each"),
        (ply([vertices(POINTS)], FORMATS[1]).replace(b"vertex 8", b"vertex 9"), "promises 9 of 'vertex'"),
        (
            ply([vertices(POINTS), faces(FACES, ("list uchar int corners",), corners=[1, 2, 3])], FORMATS[1]),
            "has corners, expected a list vertex_indices",
        ),
        (ply([vertices(POINTS), faces(FACES)], FORMATS[1]).replace(b"face 4", b"face 99999999999999999999"), "promises 9999"),
        (
            ply([vertices(POINTS), faces(FACES, ("list float float vertex_indices",))]).replace(b"5 0 1", b"4.5 0 1"),
            "promises 4 of 'face'",
        ),
    ],
)
def test_what_is_wrong_is_named(data, says):
    with pytest.raises(InputError, match=f"a.ply: .*{says}"):
        PlyMesh(Path("a.ply"), data).polygons()


def test_files_of_trimesh_are_read_as_they_are():
    sphere = trimesh.creation.icosphere(2)
    for encoding in ("ascii", "binary"):
        mesh = PlyMesh(Path("s.ply"), trimesh.exchange.ply.export_ply(sphere, encoding=encoding))
        np.testing.assert_allclose(mesh.points, sphere.vertices, atol=1e-6)
        np.testing.assert_array_equal(mesh.polygons().fans(), sphere.faces)
