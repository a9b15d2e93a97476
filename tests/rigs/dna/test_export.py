"""Rigs of other kinds as DNA files: read back, both agree; what the format cannot hold is refused by name."""

import json

import numpy as np
import pytest
import torch

from riginv.errors import InputError
from riginv.rig.contract import random_controls
from riginv.rig.interface import Control, LinearRig
from rigs.dna import DnaRig
from rigs.dna.draft import Draft
from rigs.dna.export import largest_difference, write_rig
from rigs.dna.exports import draft_of
from rigs.dna.exports.blendshapes import Drive, Factor, Shape, blendshape_draft
from rigs.dna.format import read_dna, write_dna
from rigs.dna.format.container import dna_bytes
from rigs.dna.format.ragged import Ragged
from rigs.gltf import GltfRig
from rigs.shapes import ShapesRig
from tests.rigs.dna.files import draft, shared
from tests.support import sculpts
from tests.support.avatars import AvatarWriter, cube, face_avatar
from tests.support.creatures import CREATURES, write_creature
from tests.support.toys import ToyRig


def sculpted(folder, **more) -> ShapesRig:
    shapes = {name: sculpts.offset(number) for number, name in enumerate(("smile", "jaw", "smile50", "smile25", "smile_jaw"))}
    sculpts.write_folder(folder, **shapes, smile50_jaw=sculpts.offset(9), **more)
    return ShapesRig(str(folder), unit_mm=10)


def test_a_folder_of_shapes_agrees_with_its_file(tmp_path):
    rig = sculpted(tmp_path / "s")
    found = draft_of(rig)
    assert write_rig(rig, found, tmp_path / "s.dna") < 1e-4
    assert found.raw == ["jaw", "smile", "smile25", "smile50"] and len(found.psds) == 2
    again = DnaRig(str(tmp_path / "s.dna"), unit_mm=10)
    assert again.has_blendshapes and again.primary_count == 2 and again.control_names == rig.control_names
    order = [again.coefficient_names.index(name) for name in rig.coefficient_names]
    controls = random_controls(rig, 20, 0)
    torch.testing.assert_close(again.coefficients(controls)[:, order], rig.coefficients(controls), atol=1e-6, rtol=0)
    torch.testing.assert_close(again.basis[order], rig.basis, atol=1e-5, rtol=1e-5)
    assert dna_bytes(read_dna(tmp_path / "s.dna")) == (tmp_path / "s.dna").read_bytes()


def test_avatars_agree_with_their_files(face, tmp_path):
    plain = GltfRig(str(face_avatar(tmp_path / "a.glb", face, 6)))
    assert write_rig(plain, draft_of(plain), tmp_path / "a.dna") < 1e-3
    skinned = GltfRig(str(face_avatar(tmp_path / "b.glb", face, 6, joints=True)), joints=True)
    assert write_rig(skinned, draft_of(skinned), tmp_path / "b.dna") < 1e-3
    again = DnaRig(str(tmp_path / "b.dna"))
    assert again.control_names == skinned.control_names
    assert again.upper.tolist() == pytest.approx(skinned.upper.tolist())


def test_the_body_agrees_with_its_file(body, tmp_path):
    assert write_rig(body, draft_of(body), tmp_path / "body.dna") < 2e-3
    again = DnaRig(str(tmp_path / "body.dna"))
    assert again.control_names == body.control_names and len(again.model.joints) == 77
    assert (again.rest_vertices - body.rest_vertices).abs().max() < 1e-3


def test_a_class_of_a_user_may_say_what_it_is_made_of(tmp_path):
    class Mine(LinearRig):
        def __init__(self, told: bool) -> None:
            points = torch.tensor(sculpts.POINTS).float() * 20
            basis = torch.tensor(np.stack([sculpts.offset(1), sculpts.offset(2)])).float()
            super().__init__("mine", [Control("a", -2.0), Control("b")], points, torch.tensor(sculpts.FAN), basis)
            self.told = told

        def coefficients(self, controls: torch.Tensor) -> torch.Tensor:
            return torch.stack([(controls[:, 0] / -2).clamp(0, 1), controls.prod(dim=1).clamp_min(0)], dim=1)

        def dna_draft(self) -> Draft:
            minus, plus, b = (Factor(name, name) for name in ("minus", "plus", "b"))
            drives = {"minus": Drive("a", 0.0, -2.0), "plus": Drive("a"), "b": Drive("b")}
            deltas = self.basis.double().numpy()
            shapes = [Shape("minus", [minus], deltas[0]), Shape("both", [plus, b] if self.told else [minus], deltas[1])]
            faces = Ragged.of(sculpts.FAN, np.int64)
            return blendshape_draft("mine", self.rest_vertices.double().numpy(), faces, drives, shapes)

    assert write_rig(Mine(True), draft_of(Mine(True)), tmp_path / "m.dna") < 1e-4
    with pytest.raises(InputError, match="rig 'mine': as a DNA file it differs by .* mm, .*its logic differs from its draft"):
        write_rig(Mine(False), draft_of(Mine(False)), tmp_path / "n.dna")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m.dna"]


def test_what_a_file_cannot_hold_is_refused_by_name(face, tmp_path, caplog):
    for name, rig, message in (
        ("face", face, "rig 'face' cannot be written: its weights follow controls along Bezier curves, .* screen each other"),
        ("toy", ToyRig(), r"rig 'toy' \(ToyRig\) cannot be written: .*a method dna_draft\(\)"),
        ("half", sculpted(tmp_path / "h", smile_jaw50=sculpts.offset(11)), r"1 in-betweens of combinations \(smile_jaw50\)"),
    ):
        with pytest.raises(InputError, match=message):
            draft_of(rig)
        assert name
    least = ShapesRig(str(tmp_path / "h"), combination="min", exclude=["smile_jaw50"])
    with pytest.raises(InputError, match="rig.combination=min, where a DNA file holds products alone"):
        draft_of(least)
    points, faces = cube()
    avatar = AvatarWriter()
    primitive = avatar.primitive(avatar.accessor(points), faces, [avatar.accessor(points)] * 2)
    avatar.node("n", mesh=avatar.mesh("m", [primitive], ["fat", "tall"], weights=[0.25, 0.0]))
    resting = GltfRig(str(avatar.write(tmp_path / "rest.glb")), default_weights=True)
    with pytest.raises(InputError, match="target 'fat' rests at another weight than 0"):
        draft_of(resting)
    fox = write_creature(tmp_path / "fox.glb", CREATURES["fox"](), frames=4)  # its animation scales joints, which rest at 1
    with pytest.raises(InputError, match="expected angles alone: use rig.joint_translation=false rig.joint_scale=false"):
        draft_of(GltfRig(str(fox), joints=True))
    plain = GltfRig(str(fox), joints=True, joint_translation=False, joint_scale=False, joint_limit_deg=60.0)
    write_rig(plain, draft_of(plain), tmp_path / "fox.dna")
    with caplog.at_level("INFO"):
        DnaRig(str(tmp_path / "fox.dna"), unit_mm=10.0)
    assert "1,232 vertices, 0.289 x 0.918 x 1.56 m" in caplog.text


def test_the_command_says_how_far_the_two_are_apart(run, tmp_path):
    sculpted(tmp_path / "s")
    outcome = run("export_dna", "rig=shapes", "rig.folder=s", "rig.unit_mm=10", "out=made/s.dna")
    assert outcome.code == 0, outcome.text
    assert "2 GUI controls, 4 raw controls, 2 PSDs, 6 blendshape channels" in " ".join(outcome.text.split())
    assert DnaRig(str(tmp_path / "made/s.dna"), unit_mm=10).name == "s"
    again = run("export_dna", "rig=dna", "rig.file=made/s.dna", "rig.unit_mm=10", "out=t.dna")
    assert again.code == 1 and "is a DNA file already: copy it with python -m rigs.dna.copy" in again.text
    wrong = run("export_dna", "rig=shapes", "rig.folder=s", "out=t.glb")
    assert wrong.code == 1 and "expected the name of a file that ends in .dna" in wrong.text
    assert not (tmp_path / "t.dna").exists()


def test_a_file_is_copied_and_evaluated_by_commands(run, tmp_path):
    write_dna(tmp_path / "a.dna", draft().file())
    copied = run("copy_dna", "file=a.dna", "out=b.dna")
    assert copied.code == 0 and "equal to a.dna" in copied.text, copied.text
    assert (tmp_path / "b.dna").read_bytes() == (tmp_path / "a.dna").read_bytes()
    (tmp_path / "c.dna").write_bytes((tmp_path / "a.dna").read_bytes() + b"tail")
    copied = run("copy_dna", "file=c.dna", "out=d.dna")
    assert copied.code == 0 and "not equal to (4 bytes of it belong to no layer" in copied.text
    np.savez(tmp_path / "in.npz", gui=np.random.default_rng(0).random((3, 5)), raw=np.random.default_rng(1).random((4, 12)))
    evaluated = run("evaluate_dna", "file=a.dna", "inputs=in.npz", "out=out.npz")
    assert evaluated.code == 0, evaluated.text
    with np.load(tmp_path / "out.npz") as found:
        assert found["gui_raw"].shape == (3, 12) and found["raw_joints"].shape == (4, 6, 9)
        assert found["raw_vertices_mesh0"].shape == (4, 42, 3) and "lod1_joints" not in found.files
        assert found["raw_gui"].shape == (4, 5) and all(
            found[key].dtype == np.float32 for key in found.files if "rows" not in key
        )
    for arguments, message in (
        (["inputs=a.dna", "out=o.npz"], "no .npz, or a damaged one"),
        (["inputs=odd.npz", "out=o.npz"], "neither raw nor gui in it"),
        (["inputs=few.npz", "out=o.npz"], r"raw is float64 of shape (4, 3), expected numbers of shape (row, 12)"),
        (["inputs=lost.npz", "out=o.npz"], "raw has no rows, or values that are not finite"),
        (["inputs=in.npz", "out=o.csv"], "expected the name of a file that ends in .npz"),
    ):
        np.savez(tmp_path / "odd.npz", rows=np.zeros(3))
        np.savez(tmp_path / "few.npz", raw=np.zeros((4, 3)))
        np.savez(tmp_path / "lost.npz", raw=np.full((4, 12), np.nan))
        outcome = run("evaluate_dna", "file=a.dna", *arguments)
        assert outcome.code == 1 and message in " ".join(outcome.text.split()), outcome.text
    assert run("copy_dna", "file=in.npz", "out=e.dna").code == 1 and not (tmp_path / "e.dna").exists()


@pytest.fixture(scope="module")
def aura():
    """A production face: its logic, rest mesh, quads and deltas, mm, and controls of its animation."""
    logic = json.loads(shared("aura/logic.json").read_text())
    arrays, frames = np.load(shared("aura/shapes.npz")), np.load(shared("aura/animation.npz"))
    points = np.c_[arrays["rest"], np.ones(len(arrays["rest"]))]
    deltas = np.einsum("vb,kibj,vj->kvi", arrays["weights"], arrays["transforms"], points, optimize=True) * 10
    return logic, arrays["rest"].astype(np.float64) * 10, arrays["quads"], deltas, frames


def factor_of(part: dict) -> Factor:
    """A control of the face, or a hat of it."""
    name, hat = part["control"], part.get("hat")
    return Factor(name if hat is None else f"{name}{round(100 * hat[1]):02d}", name, None if hat is None else tuple(hat))


def test_a_production_face_behind_its_animators_controls_agrees_with_its_file(aura, tmp_path):
    logic, rest, quads, deltas, frames = aura
    drives = {}
    for row in logic["remap"]:
        animator = logic["animator_controls"][row["animator_control"]]["name"]
        drives[row["control"]] = Drive(animator, 0.0, float(row["sign"]))
    shapes = []
    for number, shape in enumerate(logic["aura_shapes"]):
        parts = shape.get("factors") or [{"control": shape["control"], "hat": shape.get("hat")}]
        shapes.append(Shape(shape["name"], [factor_of(part) for part in parts], deltas[number]))
    guis = [control["name"] for control in logic["animator_controls"]]
    polygons = Ragged(quads.reshape(-1), np.full(len(quads), 4))
    file = blendshape_draft("aura", rest, polygons, drives, shapes, guis).file()
    write_dna(tmp_path / "aura.dna", file)
    rig = DnaRig(str(tmp_path / "aura.dna"))
    assert len(rig.controls) == 56 and rig.primary_count == 72 and rig.lower.min() == -1
    animators = np.clip(frames["animator_controls"][::200].astype(np.float64), -1, 1)
    place = [guis.index(name) for name in rig.control_names]
    signs = np.array([row["sign"] for row in logic["remap"]])
    driven = np.clip(animators[:, [row["animator_control"] for row in logic["remap"]]] * signs, 0, 1)
    index_of = {name: number for number, name in enumerate(logic["controls"])}
    weights = np.ones((len(animators), len(shapes)))
    for number, shape in enumerate(shapes):
        for factor in shape.factors:
            value = driven[:, index_of[factor.weight]]
            if factor.hat is not None:
                left, middle, right = factor.hat
                value = np.clip(np.minimum((value - left) / (middle - left), (right - value) / (right - middle)), 0, 1)
            weights[:, number] *= value
    expected = rest + np.einsum("fk,kvc->fvc", weights, deltas)
    found = rig(torch.tensor(animators[:, place]))
    assert np.linalg.norm(found.numpy() - expected, axis=2).max() < 1e-3
    assert largest_difference(rig, rig) == 0
