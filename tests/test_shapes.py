"""A folder of shapes: its files as they stand, its names by the convention, its meshes against plain NumPy."""

import inspect
import re
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
import yaml
from safetensors.numpy import save_file

from riginv.errors import InputError
from riginv.rig_contract import check_rig
from rigs.shapes import ShapesRig
from rigs.shapes.build import build_geometry
from rigs.shapes.deltas import names_in, read_deltas
from rigs.shapes.mesh import read_mesh
from rigs.shapes.names import read_names
from tests.conftest import ROOT

# A pentagon, two quads and a triangle around eight points: faces of every kind.
POINTS = np.array([[0, 0, 0], [2, 0, 0], [3, 1, 0], [2, 2, 0], [0, 2, 0], [0, 0, 1], [2, 0, 1], [1, 3, 0]], dtype=float)
FACES = [[0, 1, 2, 3, 4], [0, 5, 6, 1], [0, 4, 7, 5], [3, 7, 4]]
FAN = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 5, 6], [0, 6, 1], [0, 4, 7], [0, 7, 5], [3, 7, 4]]


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("RIGINV_CACHE", str(tmp_path_factory.mktemp("cache")))


def offset(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=POINTS.shape).round(6)


def write_obj(path: Path, points: np.ndarray, faces=FACES, corner="{0}") -> None:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    lines += ["f " + " ".join(corner.format(index + 1) for index in face) for face in faces]
    path.write_text("\n".join(lines) + "\n")


def write_ply(path: Path, points: np.ndarray, kind: str) -> None:
    """A PLY with a colour for each vertex, and faces whose lists come after another property."""
    header = (
        f"ply\nformat {kind} 1.0\ncomment made by a test\nelement vertex {len(points)}\nproperty double x\nproperty double y\n"
    )
    header += f"property double z\nproperty uchar red\nelement face {len(FACES)}\nproperty short group\n"
    header += "property list uchar int vertex_indices\nelement edge 1\nproperty int one\nend_header\n"
    if kind == "ascii":
        body = "".join(f"{x!r} {y!r} {z!r} 7\n" for x, y, z in points.tolist())
        body += "".join(f"3 {len(face)} {' '.join(map(str, face))}\n" for face in FACES) + "9\n"
        return path.write_text(header + body)
    order = "<" if "little" in kind else ">"
    rows = [struct.pack(order + "dddB", *point, 7) for point in points]
    rows += [struct.pack(f"{order}hB{len(face)}i", 3, len(face), *face) for face in FACES]
    path.write_bytes(header.encode() + b"".join(rows) + struct.pack(order + "i", 9))


def write_folder(folder: Path, **shapes: np.ndarray) -> Path:
    folder.mkdir(exist_ok=True)
    write_obj(folder / "neutral.obj", POINTS)
    for name, points in shapes.items():
        write_obj(folder / f"{name}.obj", points)
    return folder


def posed(rig: ShapesRig, **weights: float) -> np.ndarray:
    controls = torch.zeros(1, len(rig.controls), dtype=torch.float64)
    for name, weight in weights.items():
        controls[0, rig.control_names.index(name)] = weight
    return rig.double()(controls)[0].numpy()


# The files


SEAMS = "vt 0 0\nvt 1 1\nvn 0 0 1\n"


def test_an_obj_keeps_its_order_along_seams_and_whatever_else_stands_in_it(tmp_path):
    points = POINTS + offset(0)
    path = tmp_path / "a.obj"
    write_obj(path, points, corner="{0}/1/1")
    text = path.read_text().replace("f 4/1/1", "f -5/2/1").replace("f 1/1/1 2/1/1", "f 1//1 \\\r\n 2/2")
    path.write_text(
        "# a comment\r\nmtllib ä.mtl\no head\n" + SEAMS + text.replace("\nf", "\nusemtl skin\ns 1\nf", 1), "latin-1"
    )
    mesh = read_mesh(path)
    np.testing.assert_allclose(mesh.vertices, points, atol=1e-8)
    assert [list(face) for face in np.split(mesh.corners, np.cumsum(mesh.sizes)[:-1])] == FACES
    assert mesh.triangles().tolist() == FAN


def test_an_obj_of_trimesh_and_one_with_colours_are_read_in_their_order(tmp_path):
    sphere = trimesh.creation.icosphere(2)
    sphere.export(tmp_path / "s.obj")
    sphere.visual.vertex_colors = np.full((len(sphere.vertices), 4), 100, np.uint8)
    sphere.export(tmp_path / "c.obj")
    for name in ("s.obj", "c.obj"):
        mesh = read_mesh(tmp_path / name)
        np.testing.assert_allclose(mesh.vertices, sphere.vertices, atol=1e-7)
        np.testing.assert_array_equal(mesh.triangles(), sphere.faces)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_ply_keeps_its_order_in_text_and_binary(tmp_path, kind):
    points = POINTS + offset(1)
    write_ply(tmp_path / "a.ply", points, kind)
    mesh = read_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.vertices, points)
    assert mesh.triangles().tolist() == FAN


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_ply_of_trimesh_is_read_in_its_order(tmp_path, encoding):
    sphere = trimesh.creation.icosphere(2)
    sphere.export(tmp_path / "s.ply", encoding=encoding)
    mesh = read_mesh(tmp_path / "s.ply")
    np.testing.assert_allclose(mesh.vertices, sphere.vertices, atol=1e-6)
    np.testing.assert_array_equal(mesh.triangles(), sphere.faces)


# The names


def test_names_are_taken_by_the_convention():
    names = (
        "a a50 a25 b a_b a50_b a_b_c c a_b50 a_c50 c50 brow_up brow_up_L brow_up_a AU12 AU1 AU2 x50 a5 a00 a150 up_a_up".split()
    )
    found = read_names(names)
    assert found.primaries == sorted("a b c brow_up brow_up_L AU12 AU1 AU2 x50 a5 a00 a150 up_a_up".split())
    assert found.inbetweens == {"a50": ("a", 0.5), "a25": ("a", 0.25), "c50": ("c", 0.5)}
    combinations = {"a_b": ("a", "b"), "a50_b": ("a50", "b"), "a_c50": ("a", "c50"), "a_b_c": ("a", "b", "c")}
    assert found.combinations == {**combinations, "brow_up_a": ("brow_up", "a")}
    assert found.combination_inbetweens == {"a_b50": ("a_b", 0.5)}
    assert sorted(found.names) == sorted(names)
    assert found.pose("a50_b") == {"a": 0.5, "b": 1.0} and found.pose("a_b50") == {"a": 0.5, "b": 0.5}


def test_the_longest_part_is_taken_first_and_a_shape_is_never_combined_with_itself():
    found = read_names("up brow brow_raise raise_lid lid brow_raise_lid up_up up_up50 up50".split())
    assert found.combinations == {"brow_raise_lid": ("brow_raise", "lid")}
    assert found.inbetweens == {"up50": ("up", 0.5), "up_up50": ("up_up", 0.5)}
    assert len(read_names(["a", "a_a", "_".join("a" * 120) + "_x"]).primaries) == 3  # and quickly


def test_one_combination_cannot_stand_there_twice():
    with pytest.raises(InputError, match="'a_b' and 'b_a' both combine"):
        read_names(["a", "b", "a_b", "b_a"])


# The rig


def test_every_sculpt_is_made_exactly_where_it_belongs_and_linear_paths_lead_there(tmp_path):
    names = ["a", "a25", "a50", "b", "c", "a_b", "a_b_c", "a50_b", "a_b50", "brow_L"]
    sculpts = {name: POINTS + offset(number) for number, name in enumerate(names)}
    for combination in ("product", "min"):
        rig = ShapesRig(str(write_folder(tmp_path / "rig", **sculpts)), combination=combination)
        assert rig.control_names == ("a", "b", "brow_L", "c") and rig.primary_count == 4
        np.testing.assert_allclose(posed(rig), POINTS, atol=1e-6)
        for name in names:
            np.testing.assert_allclose(posed(rig, **rig.shapes.pose(name)), sculpts[name], atol=1e-5, err_msg=name)
        knots = {0.0: POINTS, 0.25: sculpts["a25"], 0.5: sculpts["a50"], 1.0: sculpts["a"]}
        for weight in np.linspace(0, 1, 21):
            left = max(knot for knot in knots if knot <= weight)
            right = min(knot for knot in knots if knot >= weight)
            share = (weight - left) / (right - left) if right > left else 0
            expected = (1 - share) * knots[left] + share * knots[right]
            np.testing.assert_allclose(posed(rig, a=weight), expected, atol=1e-5)
        check_rig(ShapesRig(str(tmp_path / "rig"), combination=combination))


@pytest.mark.parametrize(("combination", "rule"), [("product", np.prod), ("min", np.min)])
def test_between_sculpts_combinations_follow_their_rule(tmp_path, combination, rule):
    a, b, c, ab, abc = (offset(number) for number in range(5))
    shapes = {"a": POINTS + a, "b": POINTS + b, "c": POINTS + c, "a_b": POINTS + ab, "a_b_c": POINTS + abc}
    rig = ShapesRig(str(write_folder(tmp_path / "rig", **shapes)), combination=combination)
    weights = np.random.default_rng(9).random((20, 3))
    pair = ab - a - b
    triple = abc - a - b - c - pair
    for x, y, z in weights:
        expected = POINTS + x * a + y * b + z * c + rule([x, y]) * pair + rule([x, y, z]) * triple
        np.testing.assert_allclose(posed(rig, a=x, b=y, c=z), expected, atol=1e-5)


def test_deltas_come_from_arrays_and_from_meshes_that_are_said_to_hold_them(tmp_path):
    a, b, c, ab, bc, d = (offset(number) for number in range(6))
    folder = write_folder(tmp_path / "rig", a=POINTS + a, d=d)
    np.save(folder / "b.npy", b)
    np.savez(folder / "table.npz", c=c.astype(np.float32), a_b=ab)
    save_file({"b_c": bc}, folder / "more.safetensors")
    rig = ShapesRig(str(folder), deltas=["d"], unit_mm=10)
    assert rig.coefficient_names == ("a", "b", "c", "d", "a_b", "b_c")
    np.testing.assert_allclose(rig.basis.numpy(), 10 * np.stack([a, b, c, d, ab, bc]), atol=1e-5)
    np.testing.assert_allclose(rig.rest_vertices.numpy(), 10 * POINTS, atol=1e-6)
    expected = 10 * (POINTS + 0.5 * a + 0.4 * b + 0.2 * ab)
    np.testing.assert_allclose(posed(rig, a=0.5, b=0.4), expected, atol=1e-5)  # a combination's deltas stand as they are
    everything = ShapesRig(str(write_folder(tmp_path / "deltas", a=a)), deltas=True)
    np.testing.assert_allclose(everything.basis[0].numpy(), a, atol=1e-6)


def test_names_can_be_chosen_and_the_convention_switched_off(tmp_path):
    folder = write_folder(tmp_path / "rig", a=POINTS + offset(0), b=POINTS + offset(1), a_b=POINTS + offset(2), a50=POINTS)
    (folder / "neutral.obj").rename(folder / "rest.obj")
    write_ply(folder / "c.ply", POINTS, "ascii")
    (folder / "notes.txt").write_text("no shape")
    (folder / "._a.obj").write_text("left by a file manager")
    rig = ShapesRig(str(folder), neutral="rest.obj", include=["a*", "*.ply"], exclude=["a50"], corrective_names=False)
    assert rig.control_names == ("a", "a_b", "c") and len(rig.basis) == 3
    np.testing.assert_allclose(rig.basis[1].numpy(), offset(2), atol=1e-6)


def test_arkit_shapes_are_known_by_name(tmp_path):
    rig = ShapesRig(str(write_folder(tmp_path / "rig", jawOpen=POINTS + offset(0), jawOpen50=POINTS, smile=POINTS)))
    assert list(rig.arkit_deltas()) == ["jawOpen"]
    np.testing.assert_allclose(rig.arkit_deltas()["jawOpen"].numpy(), offset(0), atol=1e-6)


def test_what_was_taken_as_what_can_be_read(tmp_path):
    shapes = dict.fromkeys(["smile", "jaw", "smile50", "smile_jaw", "smile_L", "jaw_smle", "smile_jaw50"], POINTS)
    said = ShapesRig(str(write_folder(tmp_path / "rig", **shapes))).describe()
    for line in (
        "4 primary shapes",
        "smile50: in-between of smile at 0.5",
        "smile_jaw: combination of smile and jaw",
        "smile_jaw50: in-between of smile_jaw at 0.5",
        "jaw_smle: a shape of its own, for there is no 'smle'; if 'smile' is meant",
        "3 x 3 x 1 mm",
    ):
        assert line in said
    assert "smile_L" not in said


def test_a_folder_is_read_once_and_again_when_a_file_or_a_setting_changes(tmp_path, monkeypatch):
    read = []
    monkeypatch.setattr("rigs.shapes.build.build_geometry", lambda *given: read.append(1) or build_geometry(*given))
    folder = write_folder(tmp_path / "rig", a=POINTS + offset(0), b=POINTS)
    first = ShapesRig(str(folder))
    again = ShapesRig(str(folder))
    assert len(read) == 1 and torch.equal(first.basis, again.basis) and torch.equal(first.faces, again.faces)
    for number, settings in enumerate(({"unit_mm": 10.0}, {"exclude": ["b"]}, {"deltas": ["b"]}), start=2):
        ShapesRig(str(folder), **settings)
        assert len(read) == number
    write_obj(folder / "a.obj", POINTS + offset(1))
    np.testing.assert_allclose(ShapesRig(str(folder)).basis[0].numpy(), offset(1), atol=1e-6)
    assert len(read) == 5


def test_it_is_trained_and_evaluated_like_any_rig(run, tmp_path):
    names = ["jawOpen", "smile", "smile50", "jawOpen_smile"]
    write_folder(tmp_path / "mine", **{name: POINTS + offset(number) for number, name in enumerate(names)})
    outcome = run("train", "rig=shapes", "rig.folder=mine", "rig.unit_mm=10")
    assert outcome.code == 0, outcome.text
    assert "true rig, mine" in outcome.text and "smile50: in-between of smile at 0.5" in outcome.text
    judged = run("evaluate", "bundle=run", "poses=20", folder="judged")
    assert judged.code == 0, judged.text
    assert judged.metrics["rig_poses/mean_vertex_error_mm"] == pytest.approx(outcome.metrics["rig_poses/mean_vertex_error_mm"])


def test_the_folder_of_the_page_is_what_the_page_says(tmp_path, monkeypatch, face):
    page = (ROOT / "docs/shapes.md").read_text(encoding="utf-8")
    script = re.findall(r"```python\n(.*?)```", page, re.DOTALL)[0]
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)
    monkeypatch.chdir(tmp_path)
    rig = ShapesRig("face-shapes", unit_mm=10)
    shown = re.findall(r"^    (face-shapes: .*?)\n      \.\.\.", page, re.MULTILINE | re.DOTALL)[0]
    assert rig.describe().startswith(shown.replace("\n    ", "\n"))
    np.testing.assert_allclose(rig.arkit_deltas()["mouthFunnel"].numpy(), face.arkit_deltas()["mouthFunnel"].numpy(), atol=1e-3)
    place = face.coefficient_names.index("jawLeft_mouthSmileLeft")
    found = rig.basis[rig.coefficient_names.index("jawLeft_mouthSmileLeft")]
    np.testing.assert_allclose(found.numpy(), face.basis[place].numpy(), atol=1e-3)  # the repair alone is found again


# Mistakes


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
        ({"b__npy": b"\x93NUMPY"}, {}, "b.npy: cannot be read as arrays of deltas"),
        ({"b__npz": b"PK\x03\x04 and no more"}, {}, "b.npz: cannot be read as arrays of deltas"),
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
    with pytest.raises(InputError, match="b.npy: cannot be read"):
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
                    assert np.isfinite(read_mesh(path).vertices).all()
                else:
                    assert all(read_deltas(path, name, len(POINTS)).shape == POINTS.shape for name in names_in(path))
                outcomes.add((path.name, "read"))
            except InputError as error:
                assert "\n" not in str(error)
                outcomes.add((path.name, "refused"))
    assert len(outcomes) == 14


def test_the_config_says_what_the_class_takes(tmp_path):
    config = yaml.safe_load((ROOT / "conf/rig/shapes.yaml").read_text())
    assert config.pop("_target_") == "rigs.shapes.ShapesRig" and config.pop("folder") == "???"
    defaults = {name: given.default for name, given in inspect.signature(ShapesRig).parameters.items() if name != "folder"}
    assert {name: list(value) if isinstance(value, tuple) else value for name, value in defaults.items()} == config
