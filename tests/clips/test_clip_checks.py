"""Units, topology and frames of clips: what is guessed, chosen and refused."""

import numpy as np
import pytest

from riginv.clips.topology import check_topology
from riginv.clips.vertex_map import MappedVertices
from riginv.errors import InputError
from tests.support.clips import (
    as_clip,
    obj_sequence,
    opened,
    write_npz,
    write_obj,
)


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
    with pytest.raises(InputError, match=r"millimetres \(about 510 would fit\), or the rig's, .*rig.unit_mm"):
        as_clip(tiny, rig, unit="mm")
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
