"""Actors whose face at rest is not the rig's: a given neutral, one that is solved for, and what the command leaves."""

import csv
import json

import numpy as np
import pytest
import torch
import trimesh

from riginv.meshes.obj import obj_text
from riginv.rig.batches import generator_at
from tests.conftest import ROOT
from tests.support.clips import write_npz
from tests.support.scans import write_ply, write_ragged
from tests.support.toys import ToyRig

TOY = ("rig=toy", f"--config-dir={ROOT / 'tests/conf'}", "look.page=false", "look.sheet=false")
FRAMES = 40


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig()


def curves(rig: ToyRig, frames: int = FRAMES) -> torch.Tensor:
    """Strokes of the controls, each of which is at rest most of the time."""
    time, count = torch.linspace(0, 1, frames)[:, None], len(rig.controls)
    centre = torch.linspace(0.1, 0.9, count)
    strokes = 0.8 * torch.exp(-0.5 * ((time - centre) / 0.07) ** 2)
    return torch.where(strokes > 0.02, strokes, 0.0)


def offset(rig: ToyRig) -> torch.Tensor:
    """A smooth field of about 4 mm that no rigid motion makes."""
    centres = rig.rest_vertices[torch.randint(0, len(rig.rest_vertices), (6,), generator=generator_at(5, "actor"))]
    weight = torch.exp(-0.5 * (torch.cdist(rig.rest_vertices, centres) / 30) ** 2)
    return weight @ torch.randn(6, 3, generator=generator_at(6, "actor")) * 3


def motions(frames: int = FRAMES) -> tuple[torch.Tensor, torch.Tensor]:
    """Rotations `(frame, 3, 3)` and translations `(frame, 1, 3)` of a head."""
    time = torch.linspace(0, 6, frames)[:, None]
    turns = 0.25 * torch.sin(time * torch.tensor([1.0, 1.7, 2.3]))
    cross = torch.linalg.cross(torch.eye(3)[None], turns[:, None].expand(-1, 3, -1))
    return torch.matrix_exp(cross), 30 * torch.sin(time * torch.tensor([0.7, 1.0, 1.3]))[:, None]


def found_controls(rig: ToyRig, folder) -> torch.Tensor:
    with (folder / "curves.csv").open() as file:
        return torch.tensor([[float(row[name]) for name in rig.control_names] for row in csv.DictReader(file)])


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("how", ["given", "frames", "solve"])
def test_the_controls_of_another_actor_are_found(how, moving, run, rig, tmp_path):
    truth = curves(rig)
    truth[:3] = 0
    neutral = rig.rest_vertices + offset(rig)
    with torch.no_grad():
        meshes = rig(truth) - rig.rest_vertices + neutral
    if moving:
        rotation, shift = motions()
        meshes = meshes @ rotation.mT + shift
        neutral = neutral @ rotation[30].mT + shift[30]
    clip = write_npz(tmp_path / "take.npz", meshes.numpy(), rig.faces.numpy())
    (tmp_path / "rest.obj").write_text(obj_text(neutral.numpy(), rig.faces.numpy()))
    options = {
        "given": f"actor.neutral={tmp_path / 'rest.obj'}",
        "frames": "actor.neutral_frames=[1-2]",
        "solve": "actor.neutral=solve",
    }
    common = (*TOY, f"clip={clip}", "method=levenberg_marquardt", "reading.unit=mm")
    plain = run("invert", *common, "out=plain")
    outcome = run("invert", *common, "out=o", options[how])
    assert plain.code == 0 and outcome.code == 0, outcome.text
    error = (found_controls(rig, tmp_path / "o") - truth).abs().mean()
    assert error < (0.02 if how == "solve" else 0.002)
    assert (found_controls(rig, tmp_path / "plain") - truth).abs().mean() > 10 * error
    facts = json.loads((tmp_path / "o/curves.json").read_text())["made_by"]["actor"]
    saved = np.load(tmp_path / "o/actor.npz")
    np.testing.assert_allclose(saved["offset"], saved["neutral"] - rig.rest_vertices.numpy(), atol=1e-4)
    assert abs(facts["mean_offset_mm"] - np.linalg.norm(saved["offset"], axis=1).mean()) < 1e-3


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["actor.neutral=none.obj"], "none.obj: no frames"),
        (["actor.neutral={clip}"], "40 meshes, expected one"),
        (["actor.neutral={order}"], "the vertices are in another order"),
        (["actor.neutral={mixed}"], "from the rig on average, expected at most"),
        (["actor.neutral={other}"], "cannot be brought onto the mesh"),
        (["actor.neutral={few}"], "fewer than 50 points"),
        (["actor.neutral={npz}"], "rig's skin lies on the scan, expected 50% or more"),
        (["actor.neutral={nan}"], "not finite"),
        (["actor.neutral=solve", "actor.neutral_frames=[1]"], "are both given"),
        (["actor.neutral_frames=[900]"], "actor.neutral_frames names 900"),
        (["actor.neutral_frames=[one]"], "actor.neutral_frames holds 'one'"),
        (["actor.neutral_frames=3"], "expected a list of frames"),
        (["actor.scale=1.2"], "actor.scale=1.2 needs a neutral"),
        (["actor.landmarks=map.yaml"], "actor.landmarks=map.yaml are those of a scan: give actor.neutral=SCAN"),
        (["actor.landmarks=map.yaml", "actor.neutral=solve"], "actor.landmarks=map.yaml are those of a scan"),
        (["actor.landmarks=none.yaml", "actor.neutral={other}"], "none.yaml: no such file"),
        (["actor.neutral=solve", "actor.scale=0"], "actor.scale is 0"),
    ],
)
def test_mistakes_end_in_one_sentence_and_leave_nothing(arguments, said, run, rig, tmp_path):
    rest, faces = rig.rest_vertices.numpy(), rig.faces.numpy()
    rng = np.random.default_rng(0)
    broken = rest.copy()
    broken[7] = np.nan
    write_npz(tmp_path / "take.npz", rest[None] + np.zeros((FRAMES, 1, 1)), faces)
    write_npz(tmp_path / "npz.npz", rest[None, :100], faces[(faces < 100).all(axis=1)])
    write_npz(tmp_path / "nan.npz", broken[None], faces)
    shuffled = rng.permutation(len(rest))
    needle = trimesh.creation.icosphere(3, 50.0)
    needle.apply_scale([3.0, 0.02, 0.02])
    meshes = {
        "order": (rest[shuffled], np.argsort(shuffled)[faces]),
        "mixed": (rest[shuffled], faces),
        "other": (needle.vertices, needle.faces),
        "few": (rest[:9], faces[:1] * 0 + [0, 1, 2]),
    }
    for name, (points, triangles) in meshes.items():
        (tmp_path / f"{name}.obj").write_text(obj_text(points.astype(float), triangles))
    paths = {name: tmp_path / f"{name}.obj" for name in meshes}
    paths |= {"clip": tmp_path / "take.npz", "npz": tmp_path / "npz.npz", "nan": tmp_path / "nan.npz"}
    given = [argument.format(**paths) for argument in arguments]
    outcome = run("invert", *TOY, f"clip={paths['clip']}", "out=o", "reading.unit=mm", *given)
    assert outcome.code == 1 and said in outcome.text, outcome.text
    assert "Traceback" not in outcome.text and not (tmp_path / "o").exists()


def test_scans_of_another_actor_drive_the_rig(run, tmp_path):
    """Frames and the neutral are scans of another topology, of a face that is not the rig's."""
    rig = ToyRig(detail=3)
    truth = curves(rig, 8)[1:5]
    truth[0] = 0
    with torch.no_grad():
        meshes = (rig(truth) + offset(rig)).double().numpy()
    scans = [trimesh.remesh.subdivide_loop(mesh, rig.faces.numpy(), 1) for mesh in meshes]
    write_ragged(tmp_path / "take.npz", scans, fps=24.0)
    write_ply(tmp_path / "rest.ply", *scans[0])
    common = (
        "rig=toy",
        "+rig.detail=3",
        *TOY[1:],
        f"clip={tmp_path / 'take.npz'}",
        "method=levenberg_marquardt",
        "reading.unit=mm",
    )
    errors = {}
    for name, option in {
        "plain": (),
        "file": (f"actor.neutral={tmp_path / 'rest.ply'}",),
        "frame": ("actor.neutral_frames=[0]",),
        "solve": ("actor.neutral=solve",),
    }.items():
        outcome = run("invert", *common, f"out={name}", *option)
        assert outcome.code == 0, outcome.text
        errors[name] = float((found_controls(rig, tmp_path / name) - truth).abs().mean())
        assert ("wrapped: " in outcome.text) == (name in ("file", "frame"))
    assert max(errors["file"], errors["frame"], errors["solve"]) < 0.5 * errors["plain"], errors
    assert (tmp_path / "frame/actor.obj").is_file() and "solved for with 4 scans" in outcome.text
    assert "do not tell the shape of a face from its expression" in outcome.text
    write_npz(tmp_path / "one.npz", meshes[:1], rig.faces.numpy())
    outcome = run("invert", *common[:-3], f"clip={tmp_path / 'one.npz'}", "reading.unit=mm", "out=one", "actor.neutral=solve")
    assert outcome.code == 0 and "one frame does not tell the shape" in outcome.text, outcome.text


def test_a_network_serves_an_actor_as_it_serves_the_rig(run, rig, tmp_path):
    """The same answers for the rig's own meshes and for an actor's, whose displacements are 1.5 times as large."""
    assert run("train").code == 0
    truth = curves(rig)
    with torch.no_grad():
        own = rig(truth)
    neutral = rig.rest_vertices + offset(rig)
    write_npz(tmp_path / "own.npz", own.numpy(), rig.faces.numpy())
    write_npz(tmp_path / "actor.npz", (neutral + 1.5 * (own - rig.rest_vertices)).numpy(), rig.faces.numpy())
    (tmp_path / "rest.obj").write_text(obj_text(neutral.numpy(), rig.faces.numpy()))
    common = (f"bundle={tmp_path / 'run'}", *TOY, "motion=keep", "reading.unit=mm")
    actor = (f"actor.neutral={tmp_path / 'rest.obj'}", "actor.scale=1.5")
    for name, options in {"own": (), "actor": actor}.items():
        outcome = run("invert", *common, f"clip={tmp_path / name}.npz", f"out={name}", *options)
        assert outcome.code == 0, outcome.text
    difference = found_controls(rig, tmp_path / "own") - found_controls(rig, tmp_path / "actor")
    assert float(difference.abs().max()) < 2e-3
    facts = json.loads((tmp_path / "actor/curves.json").read_text())["made_by"]["actor"]
    assert facts["scale"] == 1.5 and facts["neutral"] == "rest.obj"


def test_the_page_and_the_picture_show_the_actor(run, rig, tmp_path):
    truth = curves(rig, 12)
    neutral = rig.rest_vertices + offset(rig)
    with torch.no_grad():
        write_npz(tmp_path / "take.npz", (rig(truth) + offset(rig)).numpy(), rig.faces.numpy())
    (tmp_path / "rest.obj").write_text(obj_text(neutral.numpy(), rig.faces.numpy()))
    common = (*TOY[:2], f"clip={tmp_path / 'take.npz'}", "out=o", "reading.unit=mm", "method=levenberg_marquardt")
    outcome = run("invert", *common, f"actor.neutral={tmp_path / 'rest.obj'}")
    assert outcome.code == 0 and "the actor is " in outcome.text, outcome.text
    names = {"look.html", "frames.png", "actor.png", "actor.obj", "actor.npz"}
    assert names <= {path.name for path in (tmp_path / "o").iterdir()}
    page = (tmp_path / "o/look.html").read_text()
    assert '["actor","' in page and "mm from the rig on average" in page
    again = run("invert", *common[:3], "out=again", *common[4:], f"actor.neutral={tmp_path / 'o/actor.obj'}", "look.page=false")
    assert again.code == 0 and float((found_controls(rig, tmp_path / "again") - truth).abs().mean()) < 0.005


def test_curves_of_the_rig_take_no_actor(run, rig, tmp_path):
    (tmp_path / "curves.csv").write_text("frame,bump0\n1,0.2\n2,0.3\n")
    options = ("reading.unknown=ignore_missing", "reading.fps=24", "actor.neutral=solve")
    outcome = run("invert", *TOY, f"clip={tmp_path / 'curves.csv'}", "out=o", *options)
    assert outcome.code == 1 and "holds curves of the rig" in outcome.text, outcome.text
