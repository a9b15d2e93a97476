"""Avatars in glTF against a plain evaluation of what was written into them."""

import base64

import numpy as np
import pygltflib as gltf
import pytest
import torch
from scipy.spatial.transform import Rotation

from riginv.clips.live_link import live_link_clip
from riginv.errors import InputError
from riginv.rig.arkit import ARKIT_NAMES, arkit_parts
from riginv.rig.contract import check_rig
from rigs.gltf import GltfRig
from tests.support.avatars import AvatarWriter, cube, face_avatar

RNG = np.random.default_rng(7)
CUBE, FACES = cube()
NEAR = 1e-3  # mm


def evaluated(rig: GltfRig, **controls: float) -> np.ndarray:
    values = rig.neutral_controls.clone()[None]
    for name, value in controls.items():
        values[0, rig.control_names.index(name)] = value
    return rig(values)[0].numpy()


def near(found: np.ndarray, expected: np.ndarray, mm: float = NEAR) -> None:
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() < mm


def world_of(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points in metres by a 4x4 matrix, in mm."""
    return (points @ matrix[:3, :3].T + matrix[:3, 3]) * 1000


def matrix_of(rotation: Rotation, translation=(0, 0, 0), scale=(1, 1, 1)) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.as_matrix() * np.array(scale)
    matrix[:3, 3] = translation
    return matrix


def test_a_realistic_avatar_comes_back_to_float_precision(face, tmp_path):
    rig = GltfRig(str(face_avatar(tmp_path / "head.glb", face, 60)))
    assert rig.control_names == face.coefficient_names[:60] and rig.primary_count == 60 and rig.name == "head"
    weights = torch.rand(4, 60, dtype=torch.float64)
    expected = face.rest_vertices.double() + torch.einsum("bk,kvc->bvc", weights, face.basis[:60].double())
    assert (rig(weights) - expected).abs().max() < NEAR
    assert torch.equal(rig.faces, face.faces)
    check_rig(rig)


def test_primitives_nodes_strides_and_integers_are_placed_in_the_world(tmp_path):
    avatar = AvatarWriter()
    first, second = RNG.normal(size=(2, 3, 8, 3))  # positions and two targets of each primitive
    interleaved = avatar.view(np.stack([first[0], first[1]], axis=1).astype("<f4").tobytes(), stride=24)
    one = avatar.primitive(
        avatar.accessor(first[0], view=interleaved),
        FACES,
        [avatar.accessor(first[1], view=interleaved, offset=12), avatar.sparse(first[2] * (np.arange(8) % 3 == 0)[:, None])],
    )
    shorts = np.clip(np.round(second * 9000), -32768, 32767)
    padded = np.zeros((8, 4))
    padded[:, :3] = shorts[0]
    view = avatar.view(padded.astype("<i2").tobytes(), stride=8)
    signed = np.clip(np.round(second[1] * 60), -128, 127)
    two = avatar.primitive(
        avatar.accessor(shorts[0], "i2", normalized=True, view=view),
        FACES,
        [avatar.accessor(signed, "i1", normalized=True), None],
    )
    outer = matrix_of(Rotation.from_euler("xyz", [20, 50, -70], degrees=True), (0.1, 1.5, -0.2), (2, 2, 2))
    turn, place, scale = Rotation.from_euler("xyz", [10, -35, 80], degrees=True), (0.3, -0.1, 0.2), (1.0, 0.5, 2.0)
    parent = avatar.node("above", matrix=outer.T.reshape(-1).tolist())
    mesh = avatar.mesh("face", [one, two], ["a", "b"])
    avatar.node("head", parent, mesh=mesh, rotation=turn.as_quat().tolist(), translation=list(place), scale=list(scale))
    rig = GltfRig(str(avatar.write(tmp_path / "two.glb")))
    world = outer @ matrix_of(turn, place, scale)
    positions = np.concatenate([first[0], np.maximum(shorts[0] / 32767, -1)])
    moved_a = np.concatenate([first[1], np.maximum(signed / 127, -1)])
    moved_b = np.concatenate([first[2] * (np.arange(8) % 3 == 0)[:, None], np.zeros((8, 3))])
    near(evaluated(rig), world_of(world, positions))
    near(evaluated(rig, a=0.7, b=0.4), world_of(world, positions + 0.7 * moved_a + 0.4 * moved_b))
    assert rig.faces.tolist() == [*FACES.tolist(), *(FACES + 8).tolist()]
    assert [part[1:] for part in rig.parts] == [(0, 8), (8, 16)]
    check_rig(rig)


def test_a_sparse_accessor_changes_rows_of_a_view_and_leaves_the_view_alone(tmp_path):
    avatar = AvatarWriter()
    values = RNG.normal(size=(8, 3))
    change = np.zeros((8, 3))
    change[[2, 5]] = RNG.normal(size=(2, 3))
    base = avatar.view(values.astype("<f4").tobytes())
    moved = [avatar.accessor(values, view=base), avatar.sparse(change, base), avatar.accessor(values, view=base)]
    avatar.node("n", mesh=avatar.mesh("m", [avatar.primitive(avatar.accessor(CUBE), FACES, moved)], ["p", "q", "r"]))
    rig = GltfRig(str(avatar.write(tmp_path / "sparse.glb")))
    near(evaluated(rig, p=1) - evaluated(rig), values * 1000)
    near(evaluated(rig, q=1) - evaluated(rig), np.where(change != 0, change, values) * 1000)
    near(evaluated(rig, r=1) - evaluated(rig), values * 1000)


def test_meshes_that_share_a_target_are_driven_together(tmp_path):
    avatar = AvatarWriter()
    head, lashes = RNG.normal(size=(2, 3, 8, 3))
    for name, values, names in (("head", head, ["blink", "smile"]), ("lashes", lashes, ["wink", "blink"])):
        primitive = avatar.primitive(avatar.accessor(values[0]), FACES, [avatar.accessor(delta) for delta in values[1:]])
        avatar.node(name, mesh=avatar.mesh(name, [primitive], names))
    avatar.node("hat", mesh=avatar.mesh("hat", [avatar.primitive(avatar.accessor(CUBE), FACES)]))
    path = str(avatar.write(tmp_path / "shared.glb"))
    rig = GltfRig(path)
    assert rig.control_names == ("blink", "smile", "wink")
    moved = np.concatenate([head[0] + 0.5 * head[1], lashes[0] + 0.5 * lashes[2] + 0.25 * lashes[1]])
    near(evaluated(rig, blink=0.5, wink=0.25), moved * 1000)
    assert GltfRig(path, include=["la*"]).control_names == ("wink", "blink")
    assert GltfRig(path, exclude=["la*"]).control_names == ("blink", "smile")
    assert len(GltfRig(path, include=["*"]).rest_vertices) == 24  # the hat only where it is asked for
    near(evaluated(GltfRig(path, unit_mm=10), blink=0.5, wink=0.25), moved * 10, 1e-5)


def test_targets_without_names_are_numbered_and_those_of_two_meshes_kept_apart(tmp_path):
    avatar = AvatarWriter()
    for number, name in enumerate(("head", "body")):
        primitive = avatar.primitive(avatar.accessor(CUBE), FACES, [avatar.accessor(CUBE * 0.1)] * 2)
        avatar.node(name, mesh=avatar.mesh(name, [primitive]))
        path = avatar.write(tmp_path / f"{number}.glb")
    assert GltfRig(str(tmp_path / "0.glb")).control_names == ("target_0", "target_1")
    assert GltfRig(str(path)).control_names == ("head.target_0", "head.target_1", "body.target_0", "body.target_1")


@pytest.mark.parametrize(("mode", "corners"), [(5, [0, 1, 2, 3, 3, 4, 5]), (6, [0, 1, 2, 3]), (4, None)])
def test_strips_fans_and_plain_corners_become_triangles(tmp_path, mode, corners):
    avatar = AvatarWriter()
    points = CUBE[:6]
    primitive = avatar.primitive(avatar.accessor(points), corners, [avatar.accessor(points)], mode=mode)
    avatar.node("n", mesh=avatar.mesh("m", [primitive]))
    expected = {5: [[0, 1, 2], [1, 3, 2], [3, 4, 5]], 6: [[1, 2, 0], [2, 3, 0]], 4: [[0, 1, 2], [3, 4, 5]]}
    rig = GltfRig(str(avatar.write(tmp_path / "modes.glb")))
    assert rig.faces.tolist() == expected[mode]


def test_a_mirrored_node_keeps_its_triangles_outside(tmp_path):
    avatar = AvatarWriter()
    primitive = avatar.primitive(avatar.accessor(CUBE), FACES, [avatar.accessor(CUBE)])
    avatar.node("n", mesh=avatar.mesh("m", [primitive]), scale=[-1, 1, 1])
    rig = GltfRig(str(avatar.write(tmp_path / "mirror.glb")))
    a, b, c = rig.rest_vertices[rig.faces].unbind(1)
    assert (torch.linalg.cross(b - a, c - a) * (a + b + c)).sum(dim=1).min() > 0


def test_seams_are_welded_on_request_and_results_carried_back(tmp_path):
    avatar = AvatarWriter()
    doubled = np.concatenate([np.arange(8), [2, 5, 6]])  # 6 moves otherwise than its double: no seam
    delta = RNG.normal(size=(8, 3))[doubled]
    delta[10] += 0.1
    corners = np.where(RNG.random(FACES.shape) < 0.5, np.array([0, 1, 8, 3, 4, 9, 10, 7])[FACES], FACES)
    avatar.node(
        "n", mesh=avatar.mesh("m", [avatar.primitive(avatar.accessor(CUBE[doubled]), corners, [avatar.accessor(delta)])])
    )
    path = str(avatar.write(tmp_path / "seams.glb"))
    split, welded = GltfRig(path), GltfRig(path, weld=True)
    assert len(split.rest_vertices) == 11 and split.vertex_map.tolist() == list(range(11))
    assert len(welded.rest_vertices) == 9 and welded.vertex_map.tolist() == [*range(8), 2, 5, 8]
    near(evaluated(welded, target_0=0.3)[welded.vertex_map], evaluated(split, target_0=0.3))
    assert torch.equal(welded.rest_vertices[welded.faces], split.rest_vertices[split.faces])


def test_primitives_that_only_differ_in_material_share_their_vertices(tmp_path):
    avatar = AvatarWriter()
    positions, target = avatar.accessor(CUBE), avatar.accessor(CUBE)
    primitives = [avatar.primitive(positions, part, [target]) for part in (FACES[:6], FACES[6:])]
    avatar.node("n", mesh=avatar.mesh("m", primitives))
    rig = GltfRig(str(avatar.write(tmp_path / "materials.glb")))
    assert len(rig.rest_vertices) == 8 and rig.faces.tolist() == FACES.tolist()


def test_weights_at_rest_are_neutral_only_on_request(tmp_path):
    avatar = AvatarWriter()
    primitive = avatar.primitive(avatar.accessor(CUBE), FACES, [avatar.accessor(CUBE)] * 2)
    avatar.node("n", mesh=avatar.mesh("m", [primitive], ["fat", "tall"], weights=[0.25, 0.0]))
    path = str(avatar.write(tmp_path / "rest.glb"))
    plain, resting = GltfRig(path), GltfRig(path, default_weights=True)
    near(plain.rest_vertices.numpy(), CUBE * 1000)
    near(resting.rest_vertices.numpy(), CUBE * 1250)
    assert resting.neutral_controls.tolist() == [0.25, 0.0] and (plain.primary_count, resting.primary_count) == (2, 0)
    near(evaluated(resting, fat=0.0), CUBE * 1000)
    check_rig(resting)


@pytest.mark.parametrize("where", ["beside it", "within"])
def test_buffers_may_lie_beside_a_gltf_or_within_it(tmp_path, where):
    avatar = AvatarWriter()
    avatar.node("n", mesh=avatar.mesh("m", [avatar.primitive(avatar.accessor(CUBE), FACES, [avatar.accessor(CUBE)])]))
    avatar.write(tmp_path / "plain name.glb")
    document = gltf.GLTF2().load(str(tmp_path / "plain name.glb"))
    if where == "beside it":
        (tmp_path / "the data.bin").write_bytes(document.binary_blob())
        document.buffers[0].uri = "the%20data.bin"
    else:
        document.buffers[0].uri = "data:application/octet-stream;base64," + base64.b64encode(document.binary_blob()).decode()
    document.set_binary_blob(None)
    (tmp_path / "avatar.gltf").write_text(document.to_json())
    near(evaluated(GltfRig(str(tmp_path / "avatar.gltf")), target_0=1), CUBE * 2000)


def test_arkit_names_are_found_in_every_spelling(tmp_path):
    spelled = ["blendShape1.JawOpen", "mouthSmile_L", "head:eyeBlink_R", "Brow_Inner_Up", "jawLeft", "viseme_aa", "cheekpuff"]
    assert arkit_parts(spelled) == {
        "browInnerUp": (("Brow_Inner_Up",), 1),
        "cheekPuff": (("cheekpuff",), 1),
        "eyeBlinkRight": (("head:eyeBlink_R",), 1),
        "jawLeft": (("jawLeft",), 1),
        "jawOpen": (("blendShape1.JawOpen",), 1),
        "mouthSmileLeft": (("mouthSmile_L",), 1),
    }
    assert arkit_parts(["JAWOPEN", "jawOpen"])["jawOpen"].names == ("jawOpen",)


def test_a_live_link_recording_moves_an_avatar_with_arkit_names(tmp_path):
    avatar = AvatarWriter()
    deltas = RNG.normal(size=(52, 8, 3)) * 0.01
    primitive = avatar.primitive(avatar.accessor(CUBE), FACES, [avatar.accessor(delta) for delta in deltas])
    avatar.node("n", mesh=avatar.mesh("m", [primitive], [f"blendShape1.{name}" for name in ARKIT_NAMES]))
    rig = GltfRig(str(avatar.write(tmp_path / "arkit.glb")))
    weights = RNG.random((3, 52)).round(4)
    columns = ["Timecode", "BlendShapeCount", *(name[0].upper() + name[1:] for name in ARKIT_NAMES)]
    rows = [",".join([f"00:00:00:{frame:02d}.000", "52", *map(str, row)]) for frame, row in enumerate(weights)]
    (tmp_path / "take.csv").write_text("\n".join([",".join(columns), *rows]))
    clip = live_link_clip(tmp_path / "take.csv", rig)
    near(clip.vertices(0, 3).numpy(), (CUBE + np.einsum("fk,kvc->fvc", weights, deltas)) * 1000)


def test_an_avatar_trains_by_the_usual_command(run, face, tmp_path):
    face_avatar(tmp_path / "head.glb", face, 50)
    small = ["model.network.hidden=[32]", "trainer.max_steps=6", "data.steps_per_epoch=6", "data.batch_size=8"]
    small += [
        "evaluation.test_poses=10",
        "evaluation.validation_poses=4",
        "pictures.every_n_validations=null",
        "pictures.final=false",
    ]
    outcome = run("train", "rig=gltf", "rig.file=head.glb", "model=inverse", *small, small=False)
    assert outcome.code == 0, outcome.text
    assert outcome.metrics["true_rig"] == "head" and "rig_poses/mean_vertex_error_mm" in outcome.metrics
    assert run("check", "rig=gltf", "rig.file=head.glb").code == 0
    evaluated_again = run("evaluate", f"bundle={outcome.folder}", "poses=10", small=False, folder="again")
    assert evaluated_again.code == 0, evaluated_again.text


def test_a_file_that_must_be_given_is_asked_for(run):
    outcome = run("train", "rig=gltf", small=False)
    assert outcome.code == 1 and "rig.file must be given" in outcome.text
    with pytest.raises(InputError, match="nowhere.glb: no such file"):
        GltfRig("nowhere.glb")
