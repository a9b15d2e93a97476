"""Which of a file's animations is read, and what is said of the others."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from riginv.clips.options import ReadingOptions
from riginv.errors import InputError
from rigs.gltf import GltfRig
from rigs.gltf.clip import GltfClip
from tests.support.avatars import AvatarWriter, add_cube

TIMES = np.arange(12) / 24
WEIGHTS = np.random.default_rng(4).uniform(0, 1, (12, 2))
STILL = np.tile([[0.3, 0.6]], (12, 1))
SLIDE = np.linspace([0, 0, 0], [0.1, 0.2, 0], 12)
TURN = np.stack([np.sin(0.05 * np.arange(12)), 0 * TIMES, 0 * TIMES, np.cos(0.05 * np.arange(12))], axis=1)


class Scene(AvatarWriter):
    """A face on a skin below a root, a prop beside it, and a joint that carries nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.root = self.node("root")
        self.hips = self.node("hips", self.root)
        self.neck = self.node("neck", self.hips, translation=[0.0, 0.2, 0.0])
        self.tail = self.node("tail", self.hips)
        binds = np.tile(np.eye(4), (3, 1, 1))
        binds[1, 1, 3] = -0.2
        skin = self.skin([self.hips, self.neck, self.tail], binds)
        self.face, self.points, self.deltas = add_cube(self, "Face", ["open", "smile"], 1, skin=skin)
        self.prop, *_ = add_cube(self, "Prop", None, 2)

    def clip(self, folder: Path, **options) -> GltfClip:
        path = str(self.write(folder / "scene.glb"))
        return GltfClip(path, ReadingOptions(**options), GltfRig(path))

    def shown(self, weights: np.ndarray) -> np.ndarray:
        return self.points + np.einsum("fk,kvc->fvc", weights, self.deltas)


def near(clip: GltfClip, expected: np.ndarray) -> None:
    assert len(clip) == len(expected) and np.abs(clip.read(0, len(clip)) - expected).max() < 1e-6


@pytest.mark.parametrize(
    "first",
    [
        lambda scene: (scene.prop, "translation", TIMES, SLIDE),
        lambda scene: (scene.tail, "rotation", TIMES, TURN),  # a joint of the skin that no vertex follows
        lambda scene: (scene.root, "translation", TIMES, np.ones((12, 3)) * 0),
        lambda scene: (scene.face, "weights", TIMES, STILL),  # a pose that is held
        lambda scene: (
            scene.neck,
            "rotation",
            TIMES,
            np.tile([[0, 0, 0, 1.0]], (12, 1)) * np.where(TIMES < 0.2, 1, -1)[:, None],
        ),
        lambda scene: (scene.face, "translation", TIMES, SLIDE),  # the node of a skin does not place it
    ],
    ids=["prop", "empty joint", "no change", "pose", "same rotation", "node of a skin"],
)
def test_an_animation_that_does_not_move_the_meshes_is_passed_over(first, tmp_path):
    scene = Scene()
    scene.animation("First", first(scene))
    scene.animation("KeyAction", (scene.face, "weights", TIMES, WEIGHTS))
    scene.animation("Third", (scene.neck, "rotation", TIMES, TURN))
    clip = scene.clip(tmp_path)
    near(clip, scene.shown(WEIGHTS))
    assert (clip.facts.animation, clip.facts.other_animations) == ("KeyAction", ("First", "Third"))
    assert any(
        note.startswith(
            "Animation 2, 'KeyAction', was read, the first that moves the meshes that were read; not read: 1 'First', 3"
        )
        for note in clip.facts.notes
    )
    assert any("moved by 3 'Third': reading.animation=[2,3] plays them together" in note for note in clip.facts.notes)


@pytest.mark.parametrize(
    "move",
    [
        lambda scene: (scene.neck, "rotation", TIMES, TURN),
        lambda scene: (scene.hips, "translation", TIMES, SLIDE),
        lambda scene: (scene.root, "scale", TIMES, 1 + SLIDE),
        lambda scene: (scene.root, "translation", [0, 0.5], np.array([[[1.0, 0, 0], [0, 0, 0], [1, 0, 0]]] * 2), "CUBICSPLINE"),
        lambda scene: (
            scene.face,
            "weights",
            [0, 0.5],
            np.tile([[[1.0, 0]], [[0.0, 0]], [[1.0, 0]]], (2, 1, 1)),
            "CUBICSPLINE",
        ),
    ],
    ids=["joint", "joint above", "node above joints", "tangents of a node", "tangents of weights"],
)
def test_transforms_at_and_above_joints_move_a_skin(move, tmp_path):
    scene = Scene()
    scene.animation("Prop", (scene.prop, "translation", TIMES, SLIDE))
    scene.animation("Move", move(scene))
    clip = scene.clip(tmp_path)
    assert clip.facts.animation == "Move"
    assert np.ptp(clip.read(0, len(clip)), axis=0).max() > 0.005


def several(folder: Path) -> Scene:
    scene = Scene()
    scene.animation("Walk", (scene.neck, "rotation", TIMES, TURN))
    scene.animation("Talk", (scene.face, "weights", TIMES, WEIGHTS))
    scene.animation(None, (scene.face, "weights", TIMES, WEIGHTS[::-1]))
    scene.animation("walk 2", (scene.prop, "translation", TIMES, SLIDE))
    scene.animation("7", (scene.face, "weights", TIMES[:2], WEIGHTS[:2]))
    scene.animation("Same", (scene.face, "weights", TIMES[:3], WEIGHTS[:3]))
    scene.animation("Same", (scene.face, "weights", TIMES[:4], WEIGHTS[:4]))
    return scene


@pytest.mark.parametrize(
    ("asked", "animation", "weights"),
    [
        ("Talk", "Talk", WEIGHTS),
        ("talk", "Talk", WEIGHTS),
        (2, "Talk", WEIGHTS),
        ("2", "Talk", WEIGHTS),
        (3, "animation 3", WEIGHTS[::-1]),
        ("animation 3", "animation 3", WEIGHTS[::-1]),
        ("7", "7", WEIGHTS[:2]),
        (7, "Same", WEIGHTS[:4]),
        (6, "Same", WEIGHTS[:3]),
        (["Talk"], "Talk", WEIGHTS),
    ],
)
def test_the_user_chooses_by_name_or_number(asked, animation, weights, tmp_path):
    scene = several(tmp_path)
    clip = scene.clip(tmp_path, animation=asked)
    near(clip, scene.shown(weights))
    assert clip.facts.animation == animation and len(clip.facts.other_animations) == 6
    assert not any("was read" in note for note in clip.facts.notes)


@pytest.mark.parametrize("asked", ["Run", 0, 8, -1, 1.5, "", "Same", True, ["Talk", "Run"], "1x"])
def test_what_is_not_there_is_said_with_what_is(asked, tmp_path):
    scene = several(tmp_path)
    with pytest.raises(InputError) as refusal:
        scene.clip(tmp_path, animation=asked)
    said = str(refusal.value)
    assert (
        "reading.animation=6 or 7" in said if asked == "Same" else "1 'Walk', 2 'Talk', 3, 4 'walk 2', 5 '7', 6 'Same'" in said
    )
    assert "scene.glb" in said and "\n" not in said


def test_several_animations_play_together(tmp_path):
    scene = several(tmp_path)
    both = scene.clip(tmp_path, animation=["Walk", 2])
    walk, talk = (scene.clip(tmp_path, animation=name).read(0, 12) for name in ("Walk", "Talk"))
    assert both.facts.animation == "Walk, Talk"
    found = both.read(0, 12)
    assert min(np.abs(found - one).max() for one in (walk, talk)) > 0.005
    assert np.abs(found[0] - talk[0]).max() < 1e-6  # the walk begins at rest
    only = several(tmp_path)
    only.document.animations = only.document.animations[:2]
    assert any("reading.animation=[1,2] plays them together" in note for note in only.clip(tmp_path).facts.notes)


def test_an_animation_that_leaves_the_meshes_still_is_not_read_in_silence(tmp_path):
    scene = Scene()
    scene.animation("Slide", (scene.prop, "translation", TIMES, SLIDE))
    with pytest.raises(InputError, match=r"none of its animations \(1 'Slide'\) moves Face: .*reading.mesh.*reading.animation"):
        scene.clip(tmp_path)
    clip = scene.clip(tmp_path, animation="Slide")
    near(clip, scene.shown(np.zeros((12, 2))))
    assert clip.facts.notes[-1] == "Animation 1, 'Slide', does not move the meshes that were read: all frames are one pose."
    scene.animation("Pose", (scene.face, "weights", TIMES, STILL))
    held = scene.clip(tmp_path)
    near(held, scene.shown(STILL))
    assert held.facts.animation == "Pose" and "all frames are one pose" in " ".join(held.facts.notes)


def test_files_without_animation_are_refused(tmp_path):
    with pytest.raises(InputError, match="no animation in it"):
        Scene().clip(tmp_path)
    scene = Scene()
    scene.animation("Empty", (scene.prop, "translation", TIMES, SLIDE))
    scene.document.animations[0].channels[0].target.node = None  # what glTF leaves to extensions
    with pytest.raises(InputError, match=r"none of its animations \(1 'Empty'\) moves Face"):
        scene.clip(tmp_path)
    with pytest.raises(InputError, match=r"reading.animation=1 moves nothing; .* are: 1 'Empty'"):
        scene.clip(tmp_path, animation=1)


def test_damage_in_an_animation_that_is_read_is_refused_and_in_others_it_is_not(tmp_path):
    scene = Scene()
    scene.animation("Talk", (scene.face, "weights", TIMES, WEIGHTS))
    scene.animation("Broken", (scene.face, "weights", TIMES, WEIGHTS[:5]))
    near(scene.clip(tmp_path), scene.shown(WEIGHTS))
    with pytest.raises(InputError, match=r"animations\[1\].channels\[0\] holds 10 numbers, expected 24 for 12 keys"):
        scene.clip(tmp_path, animation="Broken")


def test_pointers_to_nodes_and_meshes_are_followed(tmp_path):
    """KHR_animation_pointer, as newer exporters use it."""
    for pointer, read in (("/nodes/{}/weights", True), ("/meshes/0/weights", True), ("/nodes/{}/weights/0", False)):
        scene = Scene()
        scene.animation("Slide", (scene.root, "translation", TIMES, SLIDE), (scene.face, "weights", TIMES, WEIGHTS))
        target = scene.document.animations[0].channels[1].target
        target.node, target.path = None, "pointer"
        target.extensions = {"KHR_animation_pointer": {"pointer": pointer.format(scene.face)}}
        scene.document.extensionsUsed = ["KHR_animation_pointer"]
        clip = scene.clip(tmp_path)
        near(clip, scene.shown(WEIGHTS * read) + SLIDE[:, None])
        assert read != any("KHR_animation_pointer, which is not read" in note for note in clip.facts.notes)


def test_names_do_not_move_the_cursor(tmp_path):
    scene = Scene()
    scene.animation("a\x1b[2Jb\nc", (scene.prop, "translation", TIMES, SLIDE))
    scene.animation("Talk", (scene.face, "weights", TIMES, WEIGHTS))
    facts = scene.clip(tmp_path).facts
    assert facts.other_animations == ("a?[2Jb?c",) and not any("\x1b" in note or "\n" in note for note in facts.notes)


def test_the_matrix_of_an_animated_node_is_taken_apart(tmp_path):
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = (
        Rotation.from_euler("xyz", [20, 30, -40], degrees=True).as_matrix() * [1, 2, 0.5],
        [0.1, 0, 0.2],
    )
    found = []
    for as_matrix in (True, False):
        scene = Scene()
        node = scene.document.nodes[scene.root]
        if as_matrix:
            node.matrix = whole.T.reshape(-1).tolist()
        else:
            node.rotation = Rotation.from_euler("xyz", [20, 30, -40], degrees=True).as_quat().tolist()
            node.scale, node.translation = [1, 2, 0.5], [0.1, 0, 0.2]
        scene.animation("Slide", (scene.root, "translation", TIMES, SLIDE), (scene.face, "weights", TIMES, WEIGHTS))
        scene.animation("Turn", (scene.root, "rotation", TIMES, TURN))
        found += [scene.clip(tmp_path, animation=number).read(0, 12) for number in (1, 2)]
    assert np.abs(found[0] - found[2]).max() < 1e-6 and np.abs(found[1] - found[3]).max() < 1e-6
    for wrong in (np.diag([-1.0, 1, 1, 1]), np.eye(4) + np.eye(4, k=1) * np.array([1, 0, 0, 0])[:, None]):
        scene = Scene()
        scene.document.nodes[scene.root].matrix = wrong.T.reshape(-1).tolist()
        scene.animation("Turn", (scene.root, "rotation", TIMES, TURN))
        with pytest.raises(InputError, match="node 'root' is animated and has a matrix that is no rotation"):
            scene.clip(tmp_path)
