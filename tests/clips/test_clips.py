"""Clips are read as they were written: in order, in windows, in millimetres, and nothing else passes for one."""

import time
from pathlib import Path

import numpy as np
import pygltflib
import pytest
import torch

from riginv.clips.topology import check_topology
from riginv.errors import InputError
from riginv.meshes.obj import read_points
from rigs.gltf.rig import GltfRig
from tests.support.avatars import AvatarWriter, face_avatar
from tests.support.clips import (
    as_clip,
    obj_sequence,
    opened,
    ply_sequence,
    write_animated_glb,
    write_mdd,
    write_npz,
    write_obj,
    write_pc2,
    write_usd,
)

KINDS = ["obj", "ply-binary", "ply-ascii", "npy", "fortran.npy", "npz", "compressed npz", "mdd", "pc2", "usd"]


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
    """50 MB/s on one core; a quarter of that is asked for here, in processor time, for others may be at work."""
    points, faces = face.rest_vertices.numpy(), face.faces.numpy()
    paths = [write_obj(tmp_path / f"head.{number:04d}.obj", points + number, faces) for number in range(8)]
    sequence = opened(tmp_path / "head.%04d.obj", face)
    began = time.process_time()
    sequence.read(0, 8)
    seconds = time.process_time() - began
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
