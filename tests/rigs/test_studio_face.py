"""The example of a studio's face: shapes alone, behind two-sided controls, and as DNA files, against its tables' own logic."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from riginv.errors import InputError
from riginv.evaluation.control_accuracy import control_accuracy
from riginv.methods.solvers import Clip
from riginv.rig.contract import check_rig, random_controls
from riginv.rig.control_effects import ControlEffects
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_sets import PosedRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from rigs.dna import DnaRig
from rigs.dna.export import write_rig
from rigs.dna.exports import draft_of
from rigs.shapes import ShapesRig
from tests.conftest import ROOT
from tests.rigs.dna.files import shared
from tests.support import sculpts

EXAMPLE = ROOT / "examples/studio_face"
CONTROLS = ["jawDrop", "jawLeft", "jawRight", "smile_L"]
ANIMATOR = [("jawDrop", None), ("jawLeft", "jawRight"), ("smile_L", None)]
MIDDLE = {"control": "jawDrop", "hat": [0.25, 0.5, 1]}
SHAPES = [
    *({"name": name, "kind": "control", "control": name} for name in CONTROLS),
    {"name": "jawDrop25", "kind": "hat", "control": "jawDrop", "hat": [0, 0.25, 0.5]},
    {"name": "jawDrop50", "kind": "hat", **MIDDLE},
    {"name": "jawDrop_jawRight", "kind": "product", "factors": [{"control": "jawDrop"}, {"control": "jawRight"}]},
    {"name": "jawDrop50_smile_L", "kind": "product", "factors": [MIDDLE, {"control": "smile_L"}]},
]


@pytest.fixture(autouse=True)
def example_on_the_path(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLE)


@pytest.fixture
def tables(tmp_path) -> list[Path]:
    """The three files of a small face, in the form of Aura's."""
    rng = np.random.default_rng(0)
    names = [f"{one}/{other}" if other else one for one, other in ANIMATOR]
    animator = [{"name": n, "positive": one, "negative": other} for n, (one, other) in zip(names, ANIMATOR)]
    (tmp_path / "logic.json").write_text(
        json.dumps({"controls": CONTROLS, "animator_controls": animator, "aura_shapes": SHAPES})
    )
    weights = rng.dirichlet(np.ones(3), len(sculpts.POINTS)).astype(np.float32)
    transforms = rng.normal(size=(len(SHAPES), 3, 3, 4)).astype(np.float32)
    quads = np.array([[0, 1, 6, 5], [0, 5, 7, 4], [3, 4, 7, 2]], dtype=np.uint16)
    rest = sculpts.POINTS.astype(np.float32)
    np.savez(tmp_path / "shapes.npz", rest=rest, quads=quads, weights=weights, transforms=transforms)
    given = rng.uniform(-1.1, 1.1, (30, 3)).clip([-0.05, -1, -0.05]).astype(np.float16)
    shapes = np.stack([given[:, 0], given[:, 1].clip(0), (-given[:, 1]).clip(0), given[:, 2]], axis=1)
    np.savez(tmp_path / "animation.npz", controls=shapes, animator_controls=given)
    return [tmp_path / "shapes.npz", tmp_path / "logic.json", tmp_path / "animation.npz"]


def aura() -> list[Path]:
    return [shared(f"aura/{name}") for name in ("shapes.npz", "logic.json", "animation.npz")]


def converted(files: list[Path], out: Path) -> Path:
    command = [sys.executable, "-m", "studio_face.convert", *map(str, files), f"out={out}"]
    done = subprocess.run(command, cwd=EXAMPLE, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


def logic_meshes(files: list[Path], controls: np.ndarray) -> np.ndarray:
    """The meshes `(frame, vertex, 3)`, mm, that the tables themselves make of their controls."""
    facts, arrays = json.loads(files[1].read_text()), np.load(files[0])
    column = {name: number for number, name in enumerate(facts["controls"])}

    def weight(part: dict) -> np.ndarray:
        if part.get("kind") == "product":
            return np.prod([weight(factor) for factor in part["factors"]], axis=0)
        value = controls[:, column[part["control"]]].astype(np.float64)
        return np.interp(value, part["hat"], [0, 1, 0]) if "hat" in part else value

    weights = np.stack([weight(shape) for shape in facts["aura_shapes"]], axis=1)
    points = np.c_[arrays["rest"], np.ones(len(arrays["rest"]))]
    bones = np.einsum("fk,kbij->fbij", weights, arrays["transforms"].transpose(0, 2, 1, 3), optimize=True)
    return 10 * (arrays["rest"] + np.einsum("vb,fbij,vj->fvi", arrays["weights"], bones, points, optimize=True))


def all_rigs(files: list[Path], folder: Path) -> tuple[list, list, np.ndarray, np.ndarray]:
    """The rigs with the shapes' controls, those with the animator's, and frames of both in their order."""
    from studio_face.rig import StudioFaceRig

    face = converted(files, folder / "face")
    plain, studio = ShapesRig(str(face), unit_mm=10), StudioFaceRig(str(face), unit_mm=10)
    found = []
    for rig in (plain, studio):
        assert write_rig(rig, draft_of(rig), folder / f"{len(rig.controls)}.dna") < 1e-3
        found.append([rig, DnaRig(str(folder / f"{len(rig.controls)}.dna"))])
    takes = []
    for kind, rig in (("shapes", plain), ("animator", studio)):
        with np.load(face / f"takes/{kind}.npz") as take:
            assert sorted(take["names"]) == sorted(rig.control_names) and take["fps"] == 30
            takes.append(take["controls"][:, [take["names"].tolist().index(name) for name in rig.control_names]])
    return *found, *takes


def largest_mm(meshes: np.ndarray, rig, controls: np.ndarray, columns: tuple[str, ...]) -> float:
    order = [columns.index(name) for name in rig.control_names]
    return float((torch.tensor(meshes) - rig(torch.tensor(controls[:, order]))).norm(dim=2).max())


def check_same_meshes(files: list[Path], folder: Path, frames: slice, tolerance_mm: float) -> list:
    """All rigs make the meshes of the tables; the two-sided ones where their controls can."""
    plain, studio, controls, animator = all_rigs(files, folder)
    names, controls, animator = plain[0].control_names, controls[frames], animator[frames]
    order = [names.index(name) for name in json.loads(files[1].read_text())["controls"]]
    for rig in plain:
        assert largest_mm(logic_meshes(files, controls[:, order]), rig, controls, names) < tolerance_mm
    weights = studio[0].primary_weights(torch.tensor(animator)).numpy()
    for rig in studio:
        assert largest_mm(logic_meshes(files, weights[:, order]), rig, animator, studio[0].control_names) < tolerance_mm
    check_rig(studio[0])
    return [controls, weights, *studio]


def test_a_small_face_is_the_same_in_every_form(tables, tmp_path):
    controls, weights, studio, dna = check_same_meshes(tables, tmp_path, slice(None), 1e-4)
    np.testing.assert_allclose(weights, controls, atol=1e-3)
    assert studio.control_names == ("jawDrop", "jawLeft_jawRight", "smile_L")
    assert studio.lower.tolist() == [0, -1, 0] == [dna.lower[dna.control_names.index(n)] for n in studio.control_names]
    assert studio.expressions()["jawDrop_jawRight"] == {"jawDrop": 1, "jawLeft_jawRight": -1}
    given = random_controls(studio, 20, 0)
    jacobian, expected = studio.coefficient_jacobian(given)[1], LinearRig.coefficient_jacobian(studio, given)[1]
    torch.testing.assert_close(jacobian.dense(), expected.dense())


@pytest.mark.slow
def test_a_production_face_is_the_same_in_every_form(tmp_path):
    controls, weights, studio, _ = check_same_meshes(aura(), tmp_path, slice(None, None, 28), 1e-4)
    assert len(studio.controls) == 56 and controls.shape == (100, 72)
    assert (np.abs(weights - controls).max(axis=1) < 1e-3).mean() > 0.95  # but for opposite sides that are on together


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["shapes", "animator"])
def test_fast_motion_of_a_production_face_is_recovered_with_its_controls(tmp_path, kind):
    """The frames in which the whole clip used to be 0.56 mm off, smoothed as by default."""
    plain, studio, controls, animator = all_rigs(aura(), tmp_path)
    rig, take = (plain[0], controls) if kind == "shapes" else (studio[0], animator)
    true = torch.tensor(take[220:320])
    meshes = PosedRig("take", rig, true)
    meshes.fps = 30.0
    found = Clip(RigInMeshSpace(rig, MeshSpace.from_rig(rig))).invert(meshes)
    with torch.no_grad():
        errors = torch.cat(
            [(rig(one) - rig(other)).norm(dim=2).mean(dim=1) for one, other in zip(found.split(20), true.split(20))]
        )
    assert errors.mean() < 0.005 and errors.max() < 0.1
    accuracy = control_accuracy(ControlEffects.of_rig(rig), found, true, is_clip=True)
    assert accuracy.precision > 0.98 and accuracy.recall > 0.98


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"jaw": {"positive": "jawDrop"}}, "no control drives shape 'jawLeft' (3 such shapes)"),
        ({"jaw": {"positive": "jawDrop", "negative": "jawUp"}}, "'jaw' drives 'jawUp', expected a primary shape"),
        ({"jaw": {"positive": "jawDrop", "negative": "jawDrop"}}, "'jawDrop' is driven by 'jaw' and 'jaw'"),
        ({"jaw": {"positive": ["jawDrop"]}}, "expected a primary shape"),
        ({"jaw": "jawDrop"}, "control 'jaw' is 'jawDrop', expected positive: SHAPE"),
        ({"jaw": {"negative": "jawDrop"}}, "expected positive: SHAPE"),
    ],
)
def test_mistakes_in_the_controls_are_named(tables, tmp_path, table, says):
    from studio_face.rig import StudioFaceRig

    face = converted(tables, tmp_path / "face")
    (face / "controls.json").write_text(json.dumps(table))
    with pytest.raises(InputError, match="controls.json") as caught:
        StudioFaceRig(str(face))
    assert says in str(caught.value)


def test_a_folder_that_exists_is_not_written_over(tables, tmp_path):
    (tmp_path / "face").mkdir()
    command = [sys.executable, "-m", "studio_face.convert", *map(str, tables), f"out={tmp_path / 'face'}"]
    done = subprocess.run(command, cwd=EXAMPLE, capture_output=True, text=True)
    assert (
        done.returncode == 1
        and done.stderr.strip().endswith("give the name of a new folder")
        and "Traceback" not in done.stderr
    )
    assert not any((tmp_path / "face").iterdir())
