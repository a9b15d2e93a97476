"""Avatars that are not quite as glTF wants them: what engines mend is mended, and said in a note."""

from pathlib import Path

import numpy as np
import pytest

from riginv.clips.options import ReadingOptions
from riginv.errors import InputError
from riginv.rig.contract import check_rig
from rigs.gltf import GltfRig
from rigs.gltf.clip import GltfClip
from tests.support.avatars import AvatarWriter, add_cube, cube

CUBE, FACES = cube()


def face(path: Path, count: int = 3, extras: dict | None = None, **change) -> str:
    """A cube with so many morph targets; `change`: of the primitive's dict, of each accessor of a target, of each target."""
    avatar = AvatarWriter()
    targets = [avatar.accessor((number + 1) * 0.1 * CUBE) for number in range(count)]
    primitive = avatar.primitive(avatar.accessor(CUBE), FACES, targets)
    for number, accessor in enumerate(targets):
        if "accessors" in change:
            avatar.document.accessors[accessor].name = change["accessors"][number]
        if "targets" in change:
            primitive.targets[number] |= change["targets"][number]
    primitive.extras = change.get("primitive", {})
    mesh = avatar.mesh("face", [primitive], weights=change.get("weights", []))
    avatar.document.meshes[mesh].extras = extras or {}
    avatar.node("head", mesh=mesh)
    return str(avatar.write(path))


@pytest.mark.parametrize(
    "fields",
    [
        {"extras": {"targetNames": ["a", "b", "c"]}},
        {"primitive": {"targetNames": ["a", "b", "c"]}},
        {"targets": [{"extra": {"name": name}} for name in "abc"]},  # UniVRM
        {"targets": [{"extras": {"name": name}} for name in "abc"]},
        {"accessors": ["a", "b", "c"]},  # FBX2glTF, Khronos's AnimatedMorphCube
    ],
    ids=["mesh", "primitive", "extra", "extras", "accessors"],
)
def test_names_of_targets_stand_in_many_places(tmp_path, fields):
    rig = GltfRig(face(tmp_path / "a.glb", **fields))
    assert rig.control_names == ("a", "b", "c") and not rig.notes


@pytest.mark.parametrize(
    ("accessors", "found"),
    [
        (["accessor_3", "accessor_4", "accessor_5"], ("target_0", "target_1", "target_2")),
        (["shape", "shape", "shape"], ("target_0", "target_1", "target_2")),
        (["a", None, "c"], ("target_0", "target_1", "target_2")),
    ],
)
def test_names_of_accessors_that_name_no_targets_are_left_alone(tmp_path, accessors, found):
    assert GltfRig(face(tmp_path / "a.glb", accessors=accessors)).control_names == found


@pytest.mark.parametrize(
    ("names", "found", "said"),
    [
        (["a"], ("a", "target_1", "target_2"), "has 3 morph targets and names 1"),
        (["a", "b", "c", "d", "e"], ("a", "b", "c"), "'d' is left out"),
        (["Basis", "a", "b", "c"], ("a", "b", "c"), "begins with 'Basis'"),
        (["a", "a", "b"], ("a", "a_2", "b"), "1 morph targets of mesh 'face' have names that others of it have, too"),
        (["a", "a_2", "a"], ("a", "a_2", "a_3"), "they are called 'a_3'"),
        (["", "b", ""], ("target_0", "b", "target_2"), ""),
    ],
)
def test_names_that_do_not_fit_the_targets_are_made_to(tmp_path, names, found, said):
    rig = GltfRig(face(tmp_path / "a.glb", extras={"targetNames": names}))
    assert rig.control_names == found and len(rig.notes) == bool(said)
    assert said in "".join(rig.notes) and all(note.endswith(".") for note in rig.notes)
    check_rig(rig)


def test_many_targets_of_one_name_are_quickly_told_apart(tmp_path):
    path = face(tmp_path / "a.glb", 1, extras={"targetNames": ["same"] * 9000})
    avatar = AvatarWriter()
    avatar.document = avatar.document.load(path)
    avatar.blob = avatar.document.binary_blob()
    avatar.document.meshes[0].primitives[0].targets *= 9000
    rig = GltfRig(str(avatar.write(tmp_path / "b.glb")))
    assert len(set(rig.control_names)) == 9000 and rig.control_names[-1] == "same_9000"


def test_a_primitive_without_targets_stands_still(tmp_path):
    avatar = AvatarWriter()
    primitives = [
        avatar.primitive(avatar.accessor(CUBE), FACES, [avatar.accessor(0.1 * CUBE)]),
        avatar.primitive(avatar.accessor(CUBE + 3), FACES),
    ]
    avatar.node("n", mesh=avatar.mesh("face", primitives, ["open"]))
    rig = GltfRig(str(avatar.write(tmp_path / "a.glb")))
    moved = (rig(rig.upper[None]) - rig.rest_vertices)[0].norm(dim=1)
    assert (moved[:8] > 100).all() and (moved[8:] == 0).all()
    assert rig.notes == ("1 of the 2 primitives of mesh 'face' have no morph targets: its 1 targets do not move them.",)


def resting(path: Path) -> str:
    avatar = AvatarWriter()
    for number, (name, weights) in enumerate((("Face", [0.3, 0.0]), ("Teeth", [0.0, 0.0]), ("Brows", [0.5]))):
        node, *_ = add_cube(avatar, name, ["jawOpen", "smile"], number)
        avatar.document.meshes[number].weights = weights
    avatar.document.nodes[node].weights = [0.9, 0.1]
    avatar.document.meshes[2].weights = [0.5]
    return str(avatar.write(path))


def test_weights_at_rest_that_nobody_asked_for_do_not_matter(tmp_path, run):
    path = resting(tmp_path / "a.glb")
    rig = GltfRig(path)
    assert rig.neutral_controls.tolist() == [0.0, 0.0] and not rig.notes
    with pytest.raises(InputError, match=r"'jawOpen' rests at 0.3 in mesh 'Face'.*rig.exclude.*rig.default_weights=false"):
        GltfRig(path, default_weights=True)
    only = GltfRig(path, default_weights=True, include=["Face"])
    assert only.neutral_controls[0] == pytest.approx(0.3)
    assert run("check", "rig=gltf", f"rig.file={path}").code == 0
    short = face(tmp_path / "b.glb", weights=[0.5])
    assert GltfRig(short).control_names == ("target_0", "target_1", "target_2")
    with pytest.raises(InputError, match="has 1 weights for its 3 morph targets"):
        GltfRig(short, default_weights=True)


def skinned(path: Path, shares: np.ndarray, dtype: str = "f4", normalized: bool = False) -> str:
    """A cube on two joints with skin weights `(8, 4)`, and an animation that turns the second."""
    avatar = AvatarWriter()
    hips = avatar.node("hips")
    neck = avatar.node("neck", hips, translation=[0.0, 0.5, 0.0])
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[1, 1, 3] = -0.5
    numbers = avatar.accessor(np.tile([1, 0, 0, 0], (8, 1)), "u1")
    more = {"JOINTS_0": numbers, "WEIGHTS_0": avatar.accessor(shares, dtype, normalized)}
    primitive = avatar.primitive(avatar.accessor(0.1 * CUBE), FACES, [avatar.accessor(0.01 * CUBE)], **more)
    avatar.node("body", mesh=avatar.mesh("body", [primitive], ["open"]), skin=avatar.skin([hips, neck], binds))
    turns = np.array([[0, 0, 0, 1.0], [0.6, 0, 0, 0.8]])
    avatar.animation("turn", (neck, "rotation", [0, 1 / 30], turns))
    return str(avatar.write(path))


SHARES = np.zeros((8, 4))
SHARES[:, 0] = np.linspace(0.1, 0.9, 8)
SHARES[:, 1] = 1 - SHARES[:, 0]


@pytest.mark.parametrize(
    ("given", "dtype", "said"),
    [
        (SHARES * np.where(np.arange(8) < 5, 0.98, 1)[:, None], "f4", "of 5 vertices of mesh 'body', primitive 0, skin 'skin'"),
        (SHARES * 3, "f4", "of 8 vertices"),
        (SHARES * np.linspace(0.2, 1.4, 8)[:, None], "f4", "(those of vertex 0 to 0.2)"),
        (np.round(SHARES * 255), "u1", "to 256"),  # bytes that should have been marked as normalised
    ],
)
def test_skin_weights_are_normalised_with_a_note(tmp_path, run, given, dtype, said):
    right, path = GltfRig(skinned(tmp_path / "a.glb", SHARES), joints=True), skinned(tmp_path / "b.glb", given, dtype)
    found = GltfRig(path, joints=True)
    posed = right.neutral_controls.clone()
    posed[right.control_names.index("neck.rx")] = 40
    assert (right(posed[None]) - found(posed[None])).abs().max() < (1.0 if dtype == "u1" else 1e-2)
    assert len(found.notes) == 1 and said in found.notes[0] and "divided by their sum" in found.notes[0]
    outcome = run("check", "rig=gltf", f"rig.file={path}")
    assert outcome.code == 0 and f"note: {found.notes[0]}" in outcome.text.replace("\n", "")


def test_vertices_without_skin_weights_follow_their_first_joint(tmp_path):
    given, expected = SHARES.copy(), SHARES.copy()
    given[[2, 6]], expected[[2, 6]] = 0, [1, 0, 0, 0]
    path = skinned(tmp_path / "a.glb", given)
    rig, right = GltfRig(path, joints=True), GltfRig(skinned(tmp_path / "b.glb", expected), joints=True)
    controls = right.upper[None] / 2
    assert (rig(controls) - right(controls)).abs().max() < 1e-3
    assert rig.notes == (
        "2 vertices of mesh 'body', primitive 0, skin 'skin' have no skin weights (the first is vertex 2): they follow the "
        "first joint that the file names for them, 'neck' for that one.",
    )
    clip = GltfClip(path, ReadingOptions(), rig)
    assert rig.notes[0] in clip.facts.notes
    assert np.isfinite(clip.read(0, 2)).all()


def test_negative_skin_weights_are_still_refused(tmp_path):
    given = SHARES.copy()
    given[3] = [1.2, -0.3, 0, 0]
    with pytest.raises(InputError, match="vertex 3 for joint 'hips' is negative"):
        GltfRig(skinned(tmp_path / "a.glb", given))
