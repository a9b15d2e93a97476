"""Rig and clip take the same meshes of a file, whatever the user chose for the rig."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from riginv.clips.open import open_clip, open_sequence
from riginv.clips.options import FrameOptions
from riginv.clips.topology import check_topology
from riginv.errors import InputError
from riginv.rig.interface import Control, LinearRig, RigBackend
from rigs.gltf import GltfRig
from rigs.gltf.clip import GltfClip
from tests.support.avatars import AvatarWriter, add_cube, cube
from tests.support.clips import reading_options

TIMES = np.arange(10) / 30
WEIGHTS = np.random.default_rng(6).uniform(0.05, 0.95, (10, 2))
SPIN = np.stack([0 * TIMES, np.sin(0.04 * np.arange(10)), 0 * TIMES, np.cos(0.04 * np.arange(10))], axis=1)


def ready_player_me(path: Path, order: tuple[str, ...] = ("Body", "Face", "Hair", "Teeth"), all_weights: bool = True) -> str:
    """One skin; Face and Teeth with morph targets, Body and Hair without; weights move all that have some."""
    avatar = AvatarWriter()
    hips = avatar.node("Hips")
    head = avatar.node("Head", hips, translation=[0.0, 0.1, 0.0])
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[1, 1, 3] = -0.1
    skin, channels = avatar.skin([hips, head], binds), []
    for name in order:
        targets = {"Face": ["jawOpen", "smile"], "Teeth": ["jawOpen"]}.get(name)
        seed = sorted(order).index(name)
        node, *_ = add_cube(avatar, name, targets, seed, skin=skin)
        if targets and (all_weights or name == "Face"):
            channels.append((node, "weights", TIMES, WEIGHTS[:, : len(targets)]))
    avatar.animation("take", *channels, (head, "rotation", TIMES, np.tile([[0, 0, 0, 1.0]], (10, 1))))
    return str(avatar.write(path))


def cubes_around(path: Path) -> str:
    """A head with targets, lashes with targets on a node below it, and a hat below it that nothing but the head moves."""
    avatar = AvatarWriter()
    head, *_ = add_cube(avatar, "head", ["jawOpen", "smile"], 0)
    lashes, *_ = add_cube(avatar, "lashes", ["jawOpen"], 1, parent=head)
    add_cube(avatar, "hat", None, 2, parent=head)
    add_cube(avatar, "floor", None, 3)
    avatar.animation("take", (head, "weights", TIMES, WEIGHTS), (lashes, "weights", TIMES, WEIGHTS[:, :1]))
    return str(avatar.write(path))


def without_names(path: Path) -> str:
    """Nodes and meshes without names, as optimisers leave them."""
    avatar = AvatarWriter()
    channels = []
    for number, names in enumerate((["jawOpen", "smile"], None, ["jawOpen"])):
        node, *_ = add_cube(avatar, "x", names, number)
        avatar.document.nodes[node].name = avatar.document.meshes[number].name = None
        channels += [(node, "weights", TIMES, WEIGHTS[:, : len(names)])] if names else []
    avatar.animation("take", *channels)
    return str(avatar.write(path))


def expected(rig: GltfRig) -> np.ndarray:
    controls = rig.neutral_controls.repeat(10, 1)
    for column, name in enumerate(("jawOpen", "smile")):
        if name in rig.control_names:
            controls[:, rig.control_names.index(name)] = torch.tensor(WEIGHTS[:, column], dtype=torch.float32)
    return rig(controls).numpy()


def fits(path: str, rig: RigBackend, meshes: np.ndarray, **options) -> GltfClip:
    clip, notes = open_clip(path, rig, reading_options(**options), FrameOptions())
    assert np.abs(clip.vertices(0, 10).numpy() - meshes).max() < 1e-3
    assert set(clip.sequence.facts.notes) <= set(notes)
    return clip.sequence


@pytest.mark.parametrize("make", [ready_player_me, cubes_around, without_names])
@pytest.mark.parametrize("options", [{}, {"joints": True}, {"include": ["*"]}, {"weld": True}, {"unit_mm": 10.0}])
def test_an_avatars_own_animation_fits_it(make, options, tmp_path):
    path = make(tmp_path / "a.glb")
    if options.get("joints") and make is not ready_player_me:
        options = {"default_weights": True}
    rig = GltfRig(path, **options)
    sequence = fits(path, rig, expected(rig))
    assert sequence.facts.meshes == tuple(name.shown for name in rig.meshes)
    left_out = bool(sequence.facts.other_meshes)
    assert left_out == (not options.get("joints") and "include" not in options)
    assert left_out == any("were read, those of the rig; not read: " in note for note in sequence.facts.notes)


@pytest.mark.parametrize(
    ("include", "asked"),
    [
        (["Face"], None),
        (["Face"], "Face"),
        (["Face"], ["F*"]),
        (["Teeth", "Face"], ["Teeth", "Face"]),
        (["Face", "Body"], None),
        (["Body", "Face"], ["Face", "Body"]),
        (["Face", "Hair"], ["F*", "H*r"]),
        (["*"], "*"),
    ],
)
def test_what_the_rig_includes_is_what_the_clip_reads(include, asked, tmp_path):
    path = ready_player_me(tmp_path / "a.glb")
    rig = GltfRig(path, include=include)
    fits(path, rig, expected(rig), mesh=asked)
    other = ready_player_me(tmp_path / "b.glb", ("Teeth", "Hair", "Face", "Body"))  # the same meshes in another order
    fits(other, rig, expected(rig), mesh=asked)


def test_a_rig_that_excludes_and_a_clip_of_fewer_channels(tmp_path):
    path = ready_player_me(tmp_path / "a.glb", all_weights=False)
    rig = GltfRig(path, exclude=["Teeth"])
    fits(path, rig, expected(rig))
    fits(ready_player_me(tmp_path / "b.glb"), rig, expected(rig))  # weights of Teeth, which the rig does not have


class Sculpted(LinearRig):
    """A rig that comes from another format and knows nothing of names in glTF."""

    def __init__(self, rig: GltfRig, part: slice) -> None:
        faces = rig.faces[((rig.faces >= part.start) & (rig.faces < part.stop)).all(dim=1)] - part.start
        controls = [Control(name) for name in rig.control_names]
        super().__init__("sculpted", controls, rig.rest_vertices[part], faces, rig.basis[:, part], rig.control_names, 2)

    def coefficients(self, controls: torch.Tensor) -> torch.Tensor:
        return controls


@pytest.mark.parametrize(
    ("include", "part", "why"),
    [
        ([], slice(0, 16), "those with morph targets"),
        (["*"], slice(0, 32), "those with morph targets or a skin"),
        ([], slice(0, 8), "whose vertices and faces are the rig's"),
    ],
)
def test_a_rig_of_another_format_finds_its_meshes_by_vertices_and_faces(include, part, why, tmp_path):
    path = ready_player_me(tmp_path / "a.glb", all_weights=False)
    avatar = GltfRig(path, include=include)
    rig = Sculpted(avatar, part)
    shown = fits(path, avatar, GltfClip(path, reading_options(), avatar).read(0, 10) * 1000)
    found = fits(path, rig, shown.read(0, 10)[:, part] * 1000)
    assert not found.facts.other_meshes or any(f"were read, {why}; not read: " in note for note in found.facts.notes)


def test_seams_that_the_rig_welds_are_welded_in_the_clip(tmp_path):
    avatar, (points, faces) = AvatarWriter(), cube()
    doubled = np.array([*range(8), 2, 5, 6])
    corners = np.where(np.random.default_rng(0).random(faces.shape) < 0.5, np.array([0, 1, 8, 3, 4, 9, 10, 7])[faces], faces)
    moved = [avatar.accessor((delta * points)[doubled]) for delta in (0.1, [0.2, 0, 0])]
    mesh = avatar.mesh("m", [avatar.primitive(avatar.accessor(points[doubled]), corners, moved)], ["jawOpen", "smile"])
    avatar.animation("take", (avatar.node("n", mesh=mesh), "weights", TIMES, WEIGHTS))
    path = str(avatar.write(tmp_path / "a.glb"))
    split, welded = GltfRig(path), GltfRig(path, weld=True)
    assert (len(split.rest_vertices), len(welded.rest_vertices)) == (11, 8)
    assert "Vertices at seams were welded as in the rig (rig.weld=true)." in fits(path, welded, expected(welded)).facts.notes
    fits(path, split, expected(split))
    fits(path, welded, expected(welded), mesh="n")


def test_of_meshes_that_fit_alike_the_one_that_moves_is_read(tmp_path):
    avatar = AvatarWriter()
    for number in range(3):
        node, *_ = add_cube(avatar, f"copy{number}", ["jawOpen", "smile"], number)
    avatar.animation("take", (node - 1, "weights", TIMES, WEIGHTS))
    path = str(avatar.write(tmp_path / "a.glb"))
    rig = Sculpted(GltfRig(path, include=["copy0"]), slice(0, 8))
    assert open_sequence(path, rig, reading_options()).facts.meshes == ("copy1",)


def test_a_mesh_that_is_no_clip_of_the_rig_is_refused_with_the_names(tmp_path):
    path = ready_player_me(tmp_path / "a.glb")
    rig = GltfRig(path, include=["Face"])
    with pytest.raises(InputError, match="16 vertices.*; read were Body, Face, and not Hair, Teeth"):
        check_topology(open_sequence(path, rig, reading_options(mesh=["Face", "Body"])), rig)
    for asked in ("Nose", ["Face", "No*"]):
        with pytest.raises(InputError, match=r"reading.mesh names 'No.*its meshes are: Body, Face, Hair, Teeth"):
            open_sequence(path, rig, reading_options(mesh=asked))
    with pytest.raises(InputError, match=r"rig.include names 'Nose'"):
        GltfRig(path, include=["Nose"])


def test_names_with_brackets_mean_themselves(tmp_path):
    avatar = AvatarWriter()
    for number, name in enumerate(("head[1]", "head1", "a*b")):
        node, *_ = add_cube(avatar, name, ["jawOpen", "smile"], number)
        avatar.animation(name, (node, "weights", TIMES, WEIGHTS))
    path = str(avatar.write(tmp_path / "a.glb"))
    assert [name.node for name in GltfRig(path, include=["a*b"]).meshes] == ["a*b"]
    assert [name.node for name in GltfRig(path, include=["head[1]"]).meshes] == ["head[1]"]
    assert [name.node for name in GltfRig(path, include=["head*"], exclude=["head[1]"]).meshes] == ["head1"]


@pytest.mark.parametrize("make", [ready_player_me, cubes_around, without_names])
def test_without_a_rig_the_meshes_of_the_rig_of_the_file_are_read(make, tmp_path):
    path = make(tmp_path / "a.glb")
    facts = GltfClip(path, reading_options()).facts
    assert facts.meshes == tuple(name.shown for name in GltfRig(path).meshes) and facts.format == "glTF"


def test_invert_finds_the_weights_of_an_avatars_own_animation(tmp_path, run):
    path = ready_player_me(tmp_path / "a.glb")
    plain = ("method=levenberg_marquardt", "motion=keep", "look.page=false", "look.sheet=false")
    for number, more in enumerate(([], ["rig.include=[Face]", "reading.mesh=Face"], ["rig.include=[Face,Teeth]"])):
        out = tmp_path / str(number)
        outcome = run("invert", "rig=gltf", f"rig.file={path}", f"clip={path}", f"out={out}", *plain, *more)
        assert outcome.code == 0, outcome.text
        with (out / "curves.csv").open() as file:
            rows = list(csv.DictReader(file))
        found = np.array([[float(row[name]) for name in ("jawOpen", "smile")] for row in rows])
        assert np.abs(found - WEIGHTS).max() < 0.01 and json.loads((out / "curves.json").read_text())["fps"] == 30
