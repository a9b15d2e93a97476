"""Skins of avatars against plain linear blend skinning."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from riginv.errors import InputError
from riginv.rig.contract import check_rig
from riginv.rig.interface import LinearRig
from rigs.gltf import GltfRig
from tests.support.avatars import AvatarWriter, cube, face_avatar

RNG = np.random.default_rng(11)
CUBE, FACES = cube()
NAMES = ["hips", "spine", "head", "end"]
ROTATIONS = Rotation.from_euler("xyz", RNG.uniform(-60, 60, (4, 3)), degrees=True)
PLACES = np.array([[0, 1.0, 0], [0.1, 0.5, 0], [0, 0.4, 0.1], [0, 0.2, 0]])
SCALES = np.array([[1, 1, 1], [1.2, 1.2, 1.2], [1, 1, 1], [1, 1, 1]])
BINDS = [np.linalg.inv(matrix) for matrix in np.eye(4) + 0.1 * RNG.normal(size=(4, 4, 4)) * (np.arange(4) < 3)[:, None]]
POSITIONS, DELTAS = RNG.normal(size=(8, 3)), RNG.normal(size=(2, 8, 3)) * np.array([[[1.0]], [[0.1]]])
DELTAS[1, 2:] = 0
SHARES = np.zeros((8, 4))
SHARES[:, :3] = RNG.dirichlet(np.ones(3), 8)
SHARES[:2] = [1, 0, 0, 0]


def local(joint: int, degrees=(0, 0, 0)) -> np.ndarray:
    matrix = np.eye(4)
    turn = Rotation.from_euler("XYZ", degrees, degrees=True).as_matrix()
    matrix[:3, :3] = ROTATIONS[joint].as_matrix() @ turn @ np.diag(SCALES[joint])
    matrix[:3, 3] = PLACES[joint]
    return matrix


def skinned(angles: np.ndarray, weights=(0.0, 0.0)) -> np.ndarray:
    """Vertices in mm by the definition: joints in a chain, `(joint, 3)` degrees."""
    world, matrices = np.eye(4), []
    for joint in range(4):
        world = world @ local(joint, angles[joint])
        matrices.append(world @ BINDS[joint])
    points = np.concatenate([POSITIONS + np.einsum("t,tvc->vc", weights, DELTAS), np.ones((8, 1))], axis=1)
    return np.einsum("vj,jrc,vc->vr", SHARES, matrices, points)[:, :3] * 1000


def dancer(path, shares=SHARES, dtype="f4", joints=None, binds=BINDS, targets=True, glasses=False, cycle=False) -> str:
    """A chain of four joints, the last of which carries nothing, with a skinned cube below a node that must not count."""
    avatar = AvatarWriter()
    node = None
    for number, name in enumerate(NAMES):
        fields = {"rotation": ROTATIONS[number].as_quat().tolist(), "translation": PLACES[number].tolist()}
        node = avatar.node(name, node, scale=SCALES[number].tolist(), **fields)
    if cycle:
        avatar.document.nodes[node].children.append(0)
    skin = avatar.skin([0, 1, 2, 3], None if binds is None else np.array(binds))
    numbers = np.tile(np.arange(4), (8, 1)) if joints is None else joints
    whole = dtype != "f4"
    values = np.round(shares * np.iinfo(dtype).max) if whole else shares
    more = {"JOINTS_0": avatar.accessor(numbers, "u1"), "WEIGHTS_0": avatar.accessor(values, dtype, normalized=whole)}
    moved = [avatar.accessor(delta) for delta in DELTAS] if targets else []
    primitive = avatar.primitive(avatar.accessor(POSITIONS), FACES, moved, **more)
    mesh = avatar.mesh("body", [primitive], ["a", "b"] if targets else None)
    avatar.node("body", mesh=mesh, skin=skin, translation=[5.0, 5.0, 5.0])
    if glasses:
        rim = avatar.mesh("rim", [avatar.primitive(avatar.accessor(CUBE), FACES, [avatar.accessor(CUBE)])], ["a"])
        avatar.node("rim", 2, mesh=rim, scale=[0.1, 0.1, 0.1])
    return str(avatar.write(path))


def posed(rig: LinearRig, angles: np.ndarray, weights=(0.0, 0.0), names=NAMES[:3]) -> np.ndarray:
    values = {f"{name}.r{axis}": angle for name, row in zip(names, angles) for axis, angle in zip("xyz", row)}
    values |= {"a": weights[0], "b": weights[1]}
    controls = torch.tensor([[values.get(name, 0.0) for name in rig.control_names]], dtype=torch.float64)
    return rig(controls)[0].numpy()


def test_without_joints_a_skin_places_its_mesh_and_the_node_does_not(tmp_path):
    rig = GltfRig(dancer(tmp_path / "a.glb"))
    assert np.abs(rig.rest_vertices.numpy() - skinned(np.zeros((4, 3)))).max() < 1e-3
    found = rig(torch.tensor([[0.4, 0.9]]))[0].numpy()
    assert np.abs(found - skinned(np.zeros((4, 3)), (0.4, 0.9))).max() < 1e-3
    assert rig.primary_count == 2
    check_rig(rig)


def test_joints_turn_vertices_and_the_deltas_of_targets(tmp_path):
    rig = GltfRig(dancer(tmp_path / "a.glb"), joints=True)
    assert rig.control_names == ("a", "b", *(f"{name}.{axis}" for name in NAMES[:3] for axis in ("rx", "ry", "rz")))
    assert rig.primary_count == 0 and rig.controls[2].unit == "deg" and rig.controls[2].lower == -60
    for _ in range(5):
        angles, weights = RNG.uniform(-60, 60, (4, 3)), RNG.random(2)
        angles[3] = 0
        assert np.abs(posed(rig, angles, weights) - skinned(angles, weights)).max() < 0.01
    check_rig(rig)
    assert len(rig.basis) == 3 * 2 + 12 * 3 + 9 * (3 + 1)  # target b moves two vertices, which only the hips carry


def test_a_joint_that_is_left_out_keeps_its_place_in_its_parent(tmp_path):
    rig = GltfRig(dancer(tmp_path / "a.glb"), joints=True, joint_include=["hips", "he*"], joint_limit_deg=30)
    assert rig.control_names[2:] == tuple(f"{name}.{axis}" for name in ("hips", "head") for axis in ("rx", "ry", "rz"))
    angles = RNG.uniform(-30, 30, (4, 3))
    angles[[1, 3]] = 0
    assert np.abs(posed(rig, angles, (0.3, 0.6)) - skinned(angles, (0.3, 0.6))).max() < 0.01
    assert rig.upper[-1] == 30


def test_what_hangs_on_a_joint_follows_it(tmp_path):
    rig = GltfRig(dancer(tmp_path / "a.glb", glasses=True), joints=True)
    angles = RNG.uniform(-60, 60, (4, 3))
    world = local(0, angles[0]) @ local(1, angles[1]) @ local(2, angles[2])
    rim = (CUBE * (0.1 * 1.5)) @ world[:3, :3].T + world[:3, 3]
    expected = np.concatenate([skinned(angles, (0.5, 0)), rim * 1000])
    assert np.abs(posed(rig, angles, (0.5, 0)) - expected).max() < 0.01


def test_a_skin_alone_makes_a_rig(tmp_path):
    path = dancer(tmp_path / "a.glb", targets=False)
    with pytest.raises(InputError, match="no morph targets in any of its meshes.*rig.joints=true"):
        GltfRig(path)
    rig = GltfRig(path, joints=True)
    angles = RNG.uniform(-60, 60, (4, 3))
    angles[3] = 0
    assert np.abs(posed(rig, angles) - skinned(angles)).max() < 0.01
    check_rig(rig)


def test_quantised_weights_are_normalised_and_absent_matrices_are_identities(tmp_path):
    exact = GltfRig(dancer(tmp_path / "a.glb"), joints=True)
    rounded = GltfRig(dancer(tmp_path / "b.glb", dtype="u1"), joints=True)
    assert 0 < (exact.rest_vertices - rounded.rest_vertices).norm(dim=1).max() < 20
    near = SHARES * (1 + 5e-4)
    assert (exact.rest_vertices - GltfRig(dancer(tmp_path / "c.glb", near)).rest_vertices).abs().max() < 1e-2
    assert torch.isfinite(GltfRig(dancer(tmp_path / "d.glb", binds=None)).rest_vertices).all()


def changed(row: list[float]) -> np.ndarray:
    shares = SHARES.copy()
    shares[3] = row
    return shares


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"shares": changed([1.2, -0.2, 0, 0])}, "weight of vertex 3 for joint 'spine' is negative"),
        ({"joints": np.tile([0, 1, 9, 3], (8, 1))}, "follows joint 9, the skin has joints 0 to 3"),
        ({"binds": BINDS[:3]}, "holds 3 matrices for 4 joints"),
        ({"binds": [*BINDS[:3], np.ones((4, 4))]}, "matrix 3 does not end in the row 0 0 0 1"),
        ({"cycle": True}, "cycle"),
    ],
)
@pytest.mark.parametrize("joints", [False, True])
def test_a_wrong_skin_is_named(tmp_path, fields, says, joints):
    path = dancer(tmp_path / "wrong.glb", **fields)
    with pytest.raises(InputError) as refused:
        GltfRig(path, joints=joints)
    assert says in str(refused.value) and "wrong.glb" in str(refused.value)


def test_globs_that_name_no_joint_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"joint_include=\['tail'\] names no joint.*hips, spine, head"):
        GltfRig(dancer(tmp_path / "a.glb"), joints=True, joint_include=["tail"])


def test_a_face_turns_as_a_whole_with_its_neck_and_keeps_its_expression(face, tmp_path):
    rig = GltfRig(str(face_avatar(tmp_path / "head.glb", face, 52, joints=True)), joints=True)
    assert rig.control_names[52:] == tuple(f"{name}.{axis}" for name in ("neck", "head", "jaw") for axis in ("rx", "ry", "rz"))
    weights = torch.rand(52)
    expected = (face.rest_vertices + torch.einsum("k,kvc->vc", weights, face.basis[:52])).double().numpy()
    low, high = face.rest_vertices.double().numpy().min(axis=0), face.rest_vertices.double().numpy().max(axis=0)
    neck = low + (high - low) * [0.5, -0.1, 0.0]
    expected = (expected - neck) @ Rotation.from_euler("XYZ", [20, -30, 10], degrees=True).as_matrix().T + neck
    found = rig(torch.cat([weights, torch.tensor([20.0, -30, 10]), torch.zeros(6)])[None])[0].numpy()
    assert np.abs(found - expected).max() < 0.01
    assert torch.allclose(rig.arkit_deltas()["jawOpen"], face.basis[face.coefficient_names.index("jawOpen")], atol=1e-3)
