"""Clips are read as they were written: in order, in windows, in millimetres, and nothing else passes for one."""

import time
from pathlib import Path

import numpy as np
import pygltflib
import pytest
import torch

from riginv.clips.clip import Clip
from riginv.clips.open import open_sequence
from riginv.clips.sequence import MeshSequence
from riginv.clips.topology import check_topology
from riginv.clips.units import resolve_units
from riginv.clips.vertex_map import MappedVertices
from riginv.errors import InputError
from riginv.meshes.obj import read_points
from rigs.gltf.rig import GltfRig
from tests.support.avatars import AvatarWriter, face_avatar
from tests.support.clips import (
    obj_sequence,
    performance,
    ply_sequence,
    reading_options,
    write_animated_glb,
    write_mdd,
    write_npz,
    write_obj,
    write_pc2,
    write_usd,
)
from tests.support.toys import ToyRig


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig(arkit=True)


@pytest.fixture(scope="module")
def meshes(rig) -> np.ndarray:
    return performance(rig)


def opened(path, rig, **options) -> MeshSequence:
    return open_sequence(str(path), rig, reading_options(**options))


def as_clip(sequence, rig, unit="auto", up="auto", fps=None, **frames) -> Clip:
    return Clip(sequence, resolve_units(sequence, rig, reading_options(unit=unit, up=up, fps=fps)), **frames)


def written(kind: str, folder: Path, meshes: np.ndarray, faces: np.ndarray) -> str | Path:
    if kind == "obj":
        return obj_sequence(folder / "obj", meshes, faces)
    if kind.startswith("ply"):
        return ply_sequence(folder / "ply", meshes, faces, kind[4:])
    if kind == "npy":
        np.save(folder / "clip.npy", meshes.astype(np.float32))
        return folder / "clip.npy"
    if kind == "fortran.npy":
        np.save(folder / "clip.npy", np.asfortranarray(meshes))
        return folder / "clip.npy"
    if kind.endswith("npz"):
        return write_npz(folder / "clip.npz", meshes, faces, compressed=kind.startswith("compressed"))
    if kind == "mdd":
        return write_mdd(folder / "clip.mdd", meshes)
    if kind == "pc2":
        return write_pc2(folder / "clip.pc2", meshes)
    pytest.importorskip("pxr", reason="usd-core is not installed")
    return write_usd(folder / "clip.usda", meshes, faces)


KINDS = ["obj", "ply-binary", "ply-ascii", "npy", "fortran.npy", "npz", "compressed npz", "mdd", "pc2", "usd"]


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_gives_the_meshes_in_any_window(kind, rig, meshes, tmp_path):
    faces = rig.faces.numpy()
    sequence = opened(written(kind, tmp_path, meshes, faces), rig)
    check_topology(sequence, rig)
    clip = as_clip(sequence, rig)
    assert len(clip) == len(meshes)
    for start, stop in ((0, 12), (3, 5), (11, 12), (2, 7)):  # backwards, too
        found = clip.vertices(start, stop)
        assert found.dtype == torch.float32
        assert np.abs(found.numpy() - meshes[start:stop]).max() < 2e-5
    if sequence.faces:
        assert np.array_equal(sequence.faces.corners.reshape(-1, 3), faces)


def test_what_files_say_of_time_and_units_is_believed(rig, meshes, tmp_path):
    faces = rig.faces.numpy()
    assert opened(write_npz(tmp_path / "a.npz", meshes, faces), rig).fps == 24
    mdd, pc2 = opened(write_mdd(tmp_path / "a.mdd", meshes), rig), opened(write_pc2(tmp_path / "a.pc2", meshes), rig)
    assert mdd.fps == 25 and pc2.fps is None and pc2.frame_numbers[0] == 1
    assert opened(obj_sequence(tmp_path / "o", meshes, faces), rig).frame_numbers.tolist() == list(range(1001, 1013))
    pytest.importorskip("pxr", reason="usd-core is not installed")
    usd = opened(write_usd(tmp_path / "a.usdc", meshes, faces), rig)
    assert (usd.fps, usd.unit_mm, usd.up) == (24, 10, "z") and usd.frame_numbers[0] == 1


def test_an_animated_avatar_moves_by_weights_and_nodes(rig, meshes, tmp_path):
    path = write_animated_glb(tmp_path / "head.glb", meshes, rig.faces.numpy())
    sequence = opened(path, rig)
    assert sequence.fps == 30 and len(sequence) == len(meshes)
    check_topology(sequence, rig)
    found = as_clip(sequence, rig).vertices(0, 12).numpy()
    slide = np.zeros((len(meshes), 1, 3))
    slide[:, 0, 1] = np.linspace(0, 1000, len(meshes))
    assert np.abs(found - meshes - slide).max() < 2e-3
    between = opened(path, rig, fps=60.0)  # halfway between two keys, weights are halfway, too
    assert len(between) == 2 * len(meshes) - 1
    halfway = as_clip(between, rig).vertices(1, 2).numpy()
    assert np.abs(halfway - (meshes[0] + meshes[1]) / 2 - (slide[0] + slide[1]) / 2).max() < 2e-3


def test_a_live_link_recording_moves_the_shapes(rig, tmp_path):
    rows = ["Timecode,BlendShapeCount,JawOpen,MouthFunnel"]
    rows += [f"00:00:0{second}:00.000,61,{second / 10},0.5" for second in range(4)]
    (tmp_path / "take.csv").write_text("\n".join(rows) + "\n")
    sequence = opened(tmp_path / "take.csv", rig)
    deltas = rig.arkit_deltas()
    expected = rig.rest_vertices + 0.3 * deltas["jawOpen"] + 0.5 * deltas["mouthFunnel"]
    assert sequence.fps == 1 and np.abs(sequence.read(3, 4)[0] - expected.numpy()).max() < 1e-4


@pytest.mark.parametrize(
    "text, count",
    [
        (b"v 1 2 3\nv 4 5 6\n", 2),
        (b"v 1 2 3 1.0\r\nv -4e0 5. .6 1.0\r\n", 2),
        (b"v 1 2 3 0.1 0.2 0.3\nv 4 5 6 1 1 1\nf 1 2 1", 2),
        (b"# v 9 9 9\n\tv   1\t2 3\nvt 0 0\nv 4 5 6", 2),
        (b"v 1 2 3\nvn 0 0 1\nv 4 5 6\n", 2),
        (b"v nan nan nan\nv 4 5 6\n", 2),
        (b"v 1 2 \\\n 3\nv 4 5 6\n", 2),
    ],
)
def test_vertex_lines_of_every_style(text, count):
    found = read_points(Path("a.obj"), text).values
    assert found.shape == (count, 3)
    assert np.allclose(found[1], [-4, 5, 0.6] if b"-4e0" in text else [4, 5, 6])


@pytest.mark.parametrize("text", [b"v 1 2\nv 4 5 6\n", b"v 1 2 x\n", b"v 1 2 3\nv 4 5 6 7 8\nv 1\n", b"v 1-2 3 4\nv 1 2 3\n"])
def test_a_broken_vertex_line_is_named(text):
    with pytest.raises(InputError, match="line"):
        read_points(Path("a.obj"), text)


def test_units_are_guessed_from_the_size_and_absurd_ones_called_out(rig, meshes, tmp_path):
    faces = rig.faces.numpy()
    for unit, mm in (("cm", 10), ("m", 1000), ("dm", 100)):
        sequence = opened(write_npz(tmp_path / f"{unit}.npz", meshes / mm, faces), rig)
        clip = as_clip(sequence, rig)
        assert clip.units.mm == mm and any(f"units of {unit} guessed" in note for note in clip.units.notes)
        assert np.abs(clip.vertices(0, 12).numpy() - meshes).max() < 1e-4
    tiny = opened(write_npz(tmp_path / "tiny.npz", meshes / 500, faces), rig)
    with pytest.raises(InputError, match=r"tiny.npz.* 0.196 mm.*reading.unit"):
        as_clip(tiny, rig, unit="mm")
    with pytest.raises(InputError, match=r"196 m,"):
        as_clip(opened(write_npz(tmp_path / "huge.npz", meshes * 2000, faces), rig), rig)
    with pytest.raises(InputError, match="reading.unit is 'parsec'"):
        as_clip(tiny, rig, unit="parsec")


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(fps, rig, meshes, tmp_path):
    sequence = opened(write_npz(tmp_path / "a.npz", meshes, rig.faces.numpy(), fps=fps), rig)
    with pytest.raises(InputError, match="frames a second, expected"):
        as_clip(sequence, rig)
    with pytest.raises(InputError, match="reading.fps"):
        as_clip(sequence, rig, fps=fps)
    assert as_clip(sequence, rig, fps=12).fps == 12


def test_another_mesh_or_another_order_is_refused_with_both_counts(rig, meshes, tmp_path):
    faces = rig.faces.numpy()
    fewer = opened(write_npz(tmp_path / "a.npz", meshes[:, :-1], np.zeros((0, 3), int)), rig)
    with pytest.raises(InputError, match=r"161 vertices.*162 vertices and 320 faces"):
        check_topology(fewer, rig)
    order = np.random.default_rng(0).permutation(meshes.shape[1])
    place = np.argsort(order)
    scrambled = opened(write_npz(tmp_path / "b.npz", meshes[:, order], place[faces]), rig)
    with pytest.raises(InputError, match=r"162 vertices and 320 faces.*edges"):
        check_topology(scrambled, rig)
    check_topology(scrambled, rig, faces=False)


def test_quads_of_the_same_mesh_and_other_diagonals_pass(rig, meshes, tmp_path):
    faces = rig.faces.numpy().tolist()
    first = faces[0]
    second = next(face for face in faces[1:] if len(set(face) & set(first)) == 2)
    a, b = sorted(set(first) & set(second))
    c, d = (set(first) - {a, b}).pop(), (set(second) - {a, b}).pop()
    others = [face for face in faces if face not in (first, second)]
    for number, shared in enumerate(([[a, c, b, d]], [[c, d, a], [d, c, b]])):  # the quad of both, and split the other way
        (tmp_path / str(number)).mkdir()
        write_obj(tmp_path / str(number) / "a.1.obj", meshes[0], [*others, *shared])
        assert not check_topology(opened(tmp_path / str(number), rig), rig)


def test_frames_are_chosen_and_excluded_by_their_own_numbers(rig, meshes, tmp_path):
    sequence = opened(obj_sequence(tmp_path / "o", meshes, rig.faces.numpy()), rig)
    clip = as_clip(sequence, rig, first=1003, last=1009, exclude=[1005, "1007-1008"])
    assert clip.frame_numbers.tolist() == list(range(1003, 1010))
    gone = clip.vertices(0, 7).isnan().all(dim=2).all(dim=1)
    assert gone.tolist() == [False, False, True, False, True, True, False]
    for wrong in ({"first": 2000}, {"exclude": [7]}, {"exclude": ["a-b"]}, {"exclude": ["1001-1012"]}):
        with pytest.raises(InputError):
            as_clip(sequence, rig, **wrong)


def test_missing_frames_are_named_or_bridged(rig, meshes, tmp_path):
    pattern = obj_sequence(tmp_path / "o", meshes, rig.faces.numpy())
    for number in (1004, 1008):
        (tmp_path / f"o/shot.{number}.obj").unlink()
    with pytest.raises(InputError, match=r"2 of frames 1001 to 1012 are missing: 1004, 1008"):
        opened(pattern, rig)
    clip = as_clip(opened(pattern, rig, missing_frames="bridge"), rig)
    assert len(clip) == 12 and clip.vertices(3, 4).isnan().all()
    for name in ("shot.####.obj", "shot.*.obj"):
        assert len(opened(tmp_path / "o" / name, rig, missing_frames="bridge")) == 12
    assert len(opened(tmp_path / "o", rig, missing_frames="bridge")) == 12


def test_a_sequence_of_mixed_meshes_is_refused_at_the_frame(rig, meshes, tmp_path):
    faces = rig.faces.numpy()
    pattern = obj_sequence(tmp_path / "o", meshes, faces)
    write_obj(tmp_path / "o/shot.1006.obj", meshes[5][:-1], faces[:100])
    with pytest.raises(InputError, match=r"shot.1006.obj: 161 vertices, and shot.1001.obj has 162"):
        as_clip(opened(pattern, rig), rig).vertices(0, 12)
    write_obj(tmp_path / "o/shot.1006.obj", meshes[5], faces[::-1])
    with pytest.raises(InputError, match=r"shot.1006.obj: its 320 faces are not the 320"):
        as_clip(opened(pattern, rig), rig).vertices(0, 12)


@pytest.mark.parametrize(
    "name", ["none.npz", "none.%04d.obj", "none.obj", "none.usda", "none.glb", "none.mdd", "none.abc", "a.xyz"]
)
def test_what_is_not_there_is_said(name, rig, tmp_path):
    if name.endswith("usda"):
        pytest.importorskip("pxr", reason="usd-core is not installed")
    with pytest.raises(InputError, match=name.replace("%", "%")):
        opened(tmp_path / name, rig)


def test_a_clip_without_frames_or_with_meshes_of_no_vertex_is_refused(rig, tmp_path):
    for shape in ((0, 162, 3), (3, 0, 3)):
        np.save(tmp_path / "a.npy", np.zeros(shape, np.float32))
        with pytest.raises(InputError, match=r"a.npy: (no frames|meshes of 0 vertices)"):
            opened(tmp_path / "a.npy", rig)
    for shape in ((162, 3), (3, 162, 2)):
        np.save(tmp_path / "a.npy", np.zeros(shape, np.float32))
        with pytest.raises(InputError, match=r"expected floats \(frame, vertex, 3\)"):
            opened(tmp_path / "a.npy", rig)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty"):
        opened(tmp_path / "empty", rig)
    with pytest.raises(InputError, match=r"shot.*: no frames"):
        opened(tmp_path / "shot.*.obj", rig)


def test_vertices_are_picked_out_of_a_larger_mesh(rig, meshes, tmp_path):
    order = np.random.default_rng(0).permutation(200)[:162]
    larger = np.zeros((len(meshes), 200, 3))
    larger[:, order] = meshes
    sequence = opened(write_npz(tmp_path / "a.npz", larger, np.zeros((0, 3), int)), rig)
    order[7] = -1
    (tmp_path / "order.txt").write_text(" ".join(map(str, order)))
    picked = MappedVertices(sequence, tmp_path / "order.txt")
    check_topology(picked, rig)
    found = picked.read(2, 5)
    assert np.isnan(found[:, 7]).all() and np.abs(np.delete(found - meshes[2:5], 7, axis=1)).max() < 1e-4
    for wrong in ("1 2 200", "1.5", "", "-2"):
        (tmp_path / "order.txt").write_text(wrong)
        with pytest.raises(InputError, match="order.txt: expected for each vertex"):
            MappedVertices(sequence, tmp_path / "order.txt")


def test_frames_that_do_not_rise_are_refused(rig, meshes, tmp_path):
    np.savez(tmp_path / "a.npz", vertices=meshes.astype(np.float32), frame_numbers=np.zeros(len(meshes), int))
    with pytest.raises(InputError, match="do not rise"):
        opened(tmp_path / "a.npz", rig)


def test_windows_bound_what_is_held(rig, meshes, tmp_path):
    """A large stored array is read in place: a window costs no more than itself."""
    import tracemalloc

    many = np.repeat(meshes, 400, axis=0).astype(np.float32)
    clip = as_clip(opened(write_npz(tmp_path / "a.npz", many, rig.faces.numpy()), rig), rig)
    tracemalloc.start()
    for start in range(0, len(clip), 64):
        clip.vertices(start, start + 64)
    held = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert held < 0.1 * many.nbytes


def test_obj_frames_are_read_fast(face, tmp_path):
    """50 MB/s on one core; a quarter of that is asked for here, because others may be at work on the machine."""
    points, faces = face.rest_vertices.numpy(), face.faces.numpy()
    paths = [write_obj(tmp_path / f"head.{number:04d}.obj", points + number, faces) for number in range(8)]
    sequence = opened(tmp_path / "head.%04d.obj", face)
    began = time.perf_counter()
    sequence.read(0, 8)
    seconds = time.perf_counter() - began
    assert sum(path.stat().st_size for path in paths) / 1e6 / seconds > 12


def test_a_skinned_avatar_turns_by_its_joints(face, tmp_path):
    """Against the same avatar as a rig, whose joints are controls: a jaw that opens while a target comes and goes."""
    path = face_avatar(tmp_path / "head.glb", face, 3, joints=True)
    document = pygltflib.GLTF2().load(str(path))
    avatar = AvatarWriter()
    avatar.document, avatar.blob = document, document.binary_blob()
    nodes = {node.name: number for number, node in enumerate(document.nodes)}
    degrees = np.array([0.0, 8.0, 16.0])
    turns = np.zeros((3, 4))
    turns[:, 0], turns[:, 3] = np.sin(np.radians(degrees) / 2), np.cos(np.radians(degrees) / 2)
    weights = np.array([[0.0, 0, 0], [0.5, 0, 1], [0, 0.2, 0]])
    times = avatar.accessor(np.arange(3) / 24)
    samplers = [pygltflib.AnimationSampler(input=times, output=avatar.accessor(values)) for values in (turns, weights.ravel())]
    channels = [
        pygltflib.AnimationChannel(sampler=number, target=pygltflib.AnimationChannelTarget(node=nodes[name], path=what))
        for number, (name, what) in enumerate((("jaw", "rotation"), ("Head", "weights")))
    ]
    document.animations.append(pygltflib.Animation(samplers=samplers, channels=channels))
    avatar.write(path)
    rig = GltfRig(str(path), joints=True)
    controls = rig.neutral_controls.repeat(3, 1)
    controls[:, rig.control_names.index("jaw.rx")] = torch.tensor(degrees, dtype=torch.float32)
    controls[:, :3] = torch.tensor(weights, dtype=torch.float32)
    sequence = opened(path, rig)
    assert sequence.fps == 24 and not check_topology(sequence, rig)
    with torch.no_grad():
        assert np.abs(1000 * sequence.read(0, 3) - rig(controls).numpy()).max() < 5e-3
