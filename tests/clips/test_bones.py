"""Skeleton motion as a clip: BVH files drive the joints of the same names of a rig."""

from pathlib import Path

import pytest
import torch

from riginv.animation import bvh
from riginv.clips.bvh import read_bvh
from riginv.clips.open import open_clip
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.errors import InputError
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.every_mesh import refine_meshes
from riginv.solvers.objective import Objective
from riginv.solvers.starts import first_start
from rigs.body import BodyRig
from rigs.gltf import GltfRig
from tests.support.animations import moving
from tests.support.creatures import fox, write_creature
from tests.support.toys import ToyRig

READING = ReadingOptions(readers={"bvh": "riginv.clips.bvh.BvhClip", "glb": "rigs.gltf.clip.GltfClip"})


@pytest.fixture(scope="module")
def take(tmp_path_factory, body: BodyRig) -> tuple[Path, torch.Tensor]:
    """A BVH file of the body in motion, and its controls."""
    animation = moving(body, numbers=torch.arange(6), with_motion=False)
    path = tmp_path_factory.mktemp("take") / "take.bvh"
    bvh.write(path, animation)
    return path, animation.controls


def opened(path: Path, rig):
    clip, notes = open_clip(str(path), rig, READING, FrameOptions())
    return clip, clip.vertices(0, len(clip)), notes


def test_joints_move_the_mesh_as_the_controls_did(take, body):
    path, controls = take
    clip, meshes, notes = opened(path, body)
    assert len(clip) == len(controls) and clip.fps == pytest.approx(25)
    assert float((meshes - body(controls)).norm(dim=2).max()) < 0.02  # mm: the file has six decimals of a centimetre
    assert any("The motion of 77 joints, found by name" in note for note in notes)


def test_joint_animation_becomes_an_animators_controls(take, body):
    _, meshes, _ = opened(take[0], body)
    space = RigInMeshSpace(body, MeshSpace.from_rig(body))
    objective, coordinates = Objective(space), space.space.encode(meshes[:4])
    found = objective.to_controls(refine_meshes(objective, coordinates, first_start(objective, coordinates), 40).units)
    assert float((body(found) - meshes[:4]).norm(dim=2).mean()) < 0.05


def test_other_spellings_sizes_and_rest_poses(take, body, tmp_path):
    text, (plain, _) = take[0].read_text(), opened(take[0], body)[1:]
    renamed = tmp_path / "renamed.bvh"
    lines = []
    for line in text.splitlines():
        words = line.split()
        if words and words[0] in ("ROOT", "JOINT"):
            line = line.replace(words[1], f"mixamorig:{words[1].upper()}")
        lines.append(line)
    head = lines.index("MOTION")
    for number, line in enumerate(lines):
        words = line.split()
        if words and words[0] == "OFFSET":
            lines[number] = "OFFSET " + " ".join(str(0.5 * float(word)) for word in words[1:])
        elif number > head + 2:
            lines[number] = " ".join(str(0.5 * float(word)) if at < 3 else word for at, word in enumerate(words))
    renamed.write_text("\n".join(lines))
    assert read_bvh(renamed).names[0] == "mixamorig:ROOT"
    moves = [number for number, line in enumerate(lines) if "CHANNELS 6" in line]
    assert len(moves) == 1  # only the root translates, so that its three columns alone were scaled
    assert float((opened(renamed, body)[1] - plain).norm(dim=2).max()) < 0.05


def test_bones_that_point_elsewhere_at_rest_are_brought_there(body, tmp_path):
    """Two files of one pose, one of which is its own pose at rest."""
    animation = moving(body, numbers=torch.arange(6), with_motion=False)
    path = tmp_path / "take.bvh"
    bvh.write(path, animation)
    motion, frame = read_bvh(path), 3
    heads, parents = motion.positions[frame], motion.parents
    text = ["HIERARCHY"]

    def joint(number: int) -> None:
        offset = heads[number] - (heads[parents[number]] if parents[number] >= 0 else 0)
        kind, channels = ("JOINT", "3") if parents[number] >= 0 else ("ROOT", "6 Xposition Yposition Zposition")
        text.extend([f"{kind} {motion.names[number]}", "{", "OFFSET " + " ".join(map(str, offset.tolist()))])
        text.append(f"CHANNELS {channels} Zrotation Yrotation Xrotation")
        for child in [child for child, parent in enumerate(parents) if parent == number]:
            joint(child)
        text.append("}")

    joint(0)
    rest = [*heads[0].tolist(), *[0.0] * (3 * len(parents))]
    other = tmp_path / "rest.bvh"
    other.write_text("\n".join([*text, "MOTION", "Frames: 1", "Frame Time: 0.04", " ".join(map(str, rest))]) + "\n")
    clip, _, notes = opened(other, body)
    assert any("point elsewhere at rest" in note for note in notes)
    wanted = body.joint_transforms(animation.controls[frame : frame + 1])[0, :, :, 3]
    found = clip.sequence.joint_transforms(0, 1)[0, :, :, 3]
    assert float((found - wanted).norm(dim=1).mean()) < 0.01 * float((wanted - wanted[0]).norm(dim=1).max())


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text[: len(text) // 3], "no whole hierarchy before MOTION"),
        (lambda text: text.rsplit("\n", 3)[0], "rows of motion, and it states"),
        (lambda text: text.replace("Frame Time: 0", "Frame Time: -0"), "its frame time is no number of seconds above 0"),
        (lambda text: text.replace("CHANNELS 6", "CHANNELS 7", 1), "are no channels"),
        (lambda text: text.rstrip() + " 1.0\n", "one for each channel"),
        (lambda text: text.replace("OFFSET", "OFFSET nan", 1), "expected finite numbers"),
        (lambda text: text.replace("ROOT ", "ROOT x").replace("JOINT ", "JOINT x"), "expected at least half"),
    ],
)
def test_damaged_files_are_one_sentence(take, body, tmp_path, change, says):
    path = tmp_path / "damaged.bvh"
    path.write_text(change(take[0].read_text()))
    with pytest.raises(InputError, match=says):
        opened(path, body)


def test_a_rig_without_a_skeleton_is_told(take):
    with pytest.raises(InputError, match="has none that is only skinned"):
        opened(take[0], ToyRig())


def test_joints_of_another_avatar_move_the_rig(tmp_path):
    """A file with the fox's skeleton and animation, whose mesh has other vertices and other bones are longer."""
    rig_file = write_creature(tmp_path / "fox.glb", fox(), frames=6)
    rig = GltfRig(str(rig_file), joints=True, joint_scale=False, joint_translation=False)
    other = fox()
    other.around = 5
    clip_file = write_creature(tmp_path / "other.glb", other, frames=6)
    clip, meshes, notes = opened(clip_file, rig)
    own, expected, _ = opened(rig_file, rig)
    assert any("Its meshes are not the rig's" in note for note in notes) and clip.fps == own.fps
    size = float((rig.rest_vertices.amax(dim=0) - rig.rest_vertices.amin(dim=0)).norm())
    assert (
        float((meshes - expected).norm(dim=2).mean()) < 0.02 * size
    )  # its animation also scales the chest and moves the tongue


def test_a_take_of_a_gltf_skeleton_is_written_and_read(tmp_path):
    rig = GltfRig(str(write_creature(tmp_path / "fox.glb", fox(), frames=6)), joints=True, joint_scale=False)
    animation = moving(rig, numbers=torch.arange(5), with_motion=False)
    bvh.write(tmp_path / "take.bvh", animation)
    _, meshes, _ = opened(tmp_path / "take.bvh", rig)
    tongue = torch.tensor([name.startswith("tongue") for name in rig.skeleton().joint_names])
    kept = (rig.skeleton().weights[:, tongue] == 0).all(dim=1)
    assert float((meshes - rig(animation.controls))[:, kept].norm(dim=2).max()) < 0.05
