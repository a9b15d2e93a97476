"""Shapes that a rig lacks: taken away from a folder of shapes, found again in a clip, and added to it."""

import json
import shutil

import numpy as np
import pytest
import torch
import trimesh

from riginv.methods.solvers import LevenbergMarquardt
from riginv.rig.mesh_sets import StoredMeshes
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.tracking.missing.drivers import Driver, numbered
from riginv.tracking.missing.finding import find_missing
from rigs.shapes import ShapesRig
from tests.config.test_bad_input import refused
from tests.conftest import ROOT
from tests.rigs.dna.files import shared
from tests.support.sculpts import write_obj

PRIMARIES = ("brow", "cheek", "jaw", "lid", "lip", "nose")
GONE = ("brow_lid", "jaw_lip", "nose50")
KEPT = ("cheek_jaw",)
FRAMES = 90
TOY = [f"--config-dir={ROOT / 'tests/conf'}"]


def bump(points: np.ndarray, seed: int, width: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    middle = rng.normal(size=3)
    near = np.exp(-0.5 * (np.linalg.norm(points - 5 * middle / np.linalg.norm(middle), axis=1) / width) ** 2)
    return np.where(near > 0.05, near, 0)[:, None] * rng.normal(size=3)


def alike_rigs(where):
    """A face of two sides, whose left and right controls are mirrored bumps; the same without both smiles' corrections."""
    points = np.stack(np.meshgrid(np.linspace(-1, 1, 21), np.linspace(0, 1, 6)), axis=2).reshape(-1, 2)
    points = np.c_[points, np.zeros(len(points))]
    faces = [[row * 21 + one, row * 21 + one + 1, row * 21 + one + 22] for row in range(5) for one in range(20)]
    middles = {"smile_L": (0.5, 0.4), "smile_R": (-0.5, 0.4), "puff_L": (0.6, 0.6), "puff_R": (-0.6, 0.6), "jaw": (0, 0.2)}
    deltas = {}
    for number, (name, middle) in enumerate(middles.items()):
        near = np.exp(-((points[:, :2] - middle) ** 2).sum(axis=1) / (1.0 if name == "jaw" else 0.15))
        deltas[name] = near[:, None] * np.random.default_rng(number).normal(size=3)
    for number, side in enumerate("LR"):
        near = np.exp(-((points[:, :2] - middles[f"smile_{side}"]) ** 2).sum(axis=1) / 0.1)
        deltas[f"smile_{side}_puff_{side}"] = near[:, None] * np.random.default_rng(20 + number).normal(size=3)
    deltas["smile_L_jaw"] = 0.5 * deltas["smile_L"][:, [1, 2, 0]]
    deltas["jaw50"] = 0.3 * deltas["jaw"][:, [2, 0, 1]]
    deltas["jaw25"] = 0.2 * deltas["jaw"][:, [1, 0, 2]]
    rigs = []
    for folder, left_out in (("whole", ()), ("less", ("smile_L_puff_L", "smile_R_puff_R", "jaw50"))):
        (where / folder).mkdir()
        write_obj(where / folder / "neutral.obj", points, faces)
        np.savez(where / folder / "deltas.npz", **{name: delta for name, delta in deltas.items() if name not in left_out})
        rigs.append(ShapesRig(str(where / folder), unit_mm=10))
    return rigs


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_shapes_whose_drivers_move_alike_are_told_apart_by_place(tmp_path, noise):
    """Left and right always move together: only the sum of both shapes is determined. Noise, mm, calls for no more shapes."""
    whole, less = alike_rigs(tmp_path)
    time = torch.linspace(0, 30, 80)
    curves = {"smile": time.sin(), "puff": (1.7 * time + 1).sin(), "jaw": (0.6 * time).cos()}
    controls = torch.stack([curves[name.split("_")[0]].clamp(0, 1) for name in whole.control_names], dim=1)
    meshes = whole(controls)
    meshes = meshes + noise * torch.randn(meshes.shape, generator=torch.Generator().manual_seed(0))
    found = find_missing(less, meshes, controls, 24, 4, known=True)
    gone = ("smile_L_puff_L", "smile_R_puff_R")
    true = {tuple(sorted(name.split("_"))): whole.basis[whole.coefficient_names.index(name)].flatten() for name in gone}
    assert len(cosines(found, true)) == 2 and min(cosines(found, true)) > 0.95
    hats = [found.rig.factors.hats[driver.factors[0]][1] for driver in found.rig.drivers if driver.name == "jaw50"]
    assert hats == [(0.25, 0.5, 1.0)]  # between its neighbours in the folder
    assert len(found.shapes) == 3
    assert float(found.after_mm.mean()) < 0.1 * float(found.before_mm.mean()) + 2 * noise


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A folder of shapes, cm; the same without three of them; and a clip of the whole one."""
    where = tmp_path_factory.mktemp("missing")
    sphere = trimesh.creation.icosphere(2, radius=5.0)
    points, faces = np.asarray(sphere.vertices), sphere.faces.tolist()
    deltas = {name: bump(points, number, 4.0) for number, name in enumerate(PRIMARIES)}
    deltas |= {name: 0.6 * bump(points, 20 + number, 2.0) for number, name in enumerate((*GONE, *KEPT))}
    for folder, left_out in (("whole", ()), ("less", GONE)):
        (where / folder).mkdir()
        write_obj(where / folder / "neutral.obj", points, faces)
        np.savez(where / folder / "deltas.npz", **{name: delta for name, delta in deltas.items() if name not in left_out})
    rig = ShapesRig(str(where / "whole"), unit_mm=10)
    time = np.linspace(0, 6 * np.pi, FRAMES)[:, None]
    rates = np.linspace(0.6, 2.1, len(PRIMARIES))
    controls = torch.tensor(np.clip(np.sin(time * rates + np.arange(len(PRIMARIES))), 0, 1)).float()
    np.savez(where / "take.npz", vertices=(rig(controls) / 10).numpy(), fps=30.0)
    np.savez(where / "curves.npz", controls=controls.numpy(), names=np.array(rig.control_names), fps=30.0)
    return where


def test_the_shapes_are_found_with_their_drivers_and_can_be_added(folders, run, tmp_path):
    outcome = run("missing", "rig=shapes", f"rig.folder={folders / 'less'}", "rig.unit_mm=10", "motion=keep", "reading.unit=cm",
                  f"clip={folders / 'take.npz'}", f"curves={folders / 'curves.npz'}", f"out={folders / 'out'}")  # fmt: skip
    assert outcome.code == 0, outcome.text
    facts = json.loads((folders / "out/missing.json").read_text())
    whole = ShapesRig(str(folders / "whole"), unit_mm=10)
    with np.load(folders / "out/shapes.npz") as deltas:
        for name in GONE:
            true = whole.basis[whole.coefficient_names.index(name)].numpy() / 10
            cosine = (deltas[name] * true).sum() / np.linalg.norm(deltas[name]) / np.linalg.norm(true)
            assert cosine > 0.98, name
    row = next(row for row in facts["shapes"] if row["name"] == "jaw_lip")
    assert row["drivers"] == ["jaw", "lip"] and row["frames"] > 3 and 0 < row["vertices"] < 162
    assert facts["mean_error_mm_with_shapes"] < 0.2 * facts["mean_error_mm"]
    errors = [row["mean_error_mm_with_first"] for row in facts["shapes"]]
    assert errors[-1] == pytest.approx(facts["mean_error_mm_with_shapes"], abs=1e-5) and errors[0] > errors[-1]
    assert facts["sentence"] in outcome.text and "would remove" in outcome.text
    assert (folders / "out/missing.png").read_bytes()[:4] == b"\x89PNG"

    pose, bare = torch.full((1, len(PRIMARIES)), 0.5), ShapesRig(str(folders / "less"), unit_mm=10)
    for kind, files in (("sculpts", [f"{name}.obj" for name in GONE]), ("deltas", ["shapes.npz"])):
        folder = shutil.copytree(folders / "less", tmp_path / kind)
        for file in files:
            shutil.copy(folders / "out" / file, folder / file)
        rig = ShapesRig(str(folder), unit_mm=10)
        assert set(GONE) <= set(rig.coefficient_names)
        assert rig.control_names == whole.control_names
        off, before = ((each(pose) - whole(pose)).norm(dim=2).mean() for each in (rig, bare))
        assert float(off) < 0.3 * float(before), kind


def test_controls_are_solved_for_where_they_are_not_known(folders, run):
    outcome = run("missing", "rig=shapes", f"rig.folder={folders / 'less'}", "rig.unit_mm=10", "motion=keep", "reading.unit=cm",
                  f"clip={folders / 'take.npz'}", f"out={folders / 'solved'}", "max_frames=60")  # fmt: skip
    assert outcome.code == 0, outcome.text
    facts = json.loads((folders / "solved/missing.json").read_text())
    assert set(GONE) <= {row["name"] for row in facts["shapes"]}
    assert facts["mean_error_mm_with_shapes"] < 0.5 * facts["mean_error_mm"]


def test_two_in_betweens_with_one_peak_are_numbered():
    drivers = [Driver((factor,), name) for factor, name in enumerate(("nose50", "jaw25", "nose50", "nose50"))]
    assert [driver.name for driver in numbered(drivers)] == ["nose50", "jaw25", "nose50-2", "nose50-3"]
    assert [driver.factors for driver in numbered(drivers)] == [(0,), (1,), (2,), (3,)]


def test_a_clip_that_the_rig_makes_lacks_nothing(folders, run):
    outcome = run("missing", "rig=shapes", f"rig.folder={folders / 'whole'}", "rig.unit_mm=10", "motion=keep", "max_frames=20",
                  "reading.unit=cm",
                  f"clip={folders / 'take.npz'}", f"curves={folders / 'curves.npz'}", f"out={folders / 'none'}")  # fmt: skip
    assert outcome.code == 0 and "The rig lacks no shape for this clip" in outcome.text, outcome.text
    assert not (folders / "none").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["rig=toy", "clip=nowhere.npz"], "nowhere.npz"),
        (["clip=a.npz"], "the rig of the clip is not given: add rig=NAME"),
        (["rig=toy", "clip=a.npz", "factors=9"], "factors is 9, expected 1 to 6"),
        (["rig=toy", "clip=a.npz", "shapes=0"], "shapes is 0"),
        (["rig=toy", "clip=a.npz", "method=clip"], "method=clip: expected refined or levenberg_marquardt"),
        (["rig=toy", "clip=a.npz", "method=refined"], "needs a trained network"),
        (["rig=toy", "clip=a.npz", "bundle=nowhere"], "nowhere"),
        (["rig=toy", "clip=a.npz", "+landmarks.map=a.yaml", "+landmarks.clip=b.trc"], "landmarks are for scans"),
        (["rig=shapes", "rig.folder=nowhere", "clip=a.npz", "curves=b.npz"], "nowhere: no such folder"),
    ],
)
def test_mistakes_are_named(run, arguments, says, tmp_path):
    refused(run("missing", *TOY, *arguments, f"out={tmp_path / 'out'}"), says)
    assert not (tmp_path / "out").exists()


def test_curves_of_the_rig_are_refused(run, tmp_path):
    np.savez(tmp_path / "take.npz", controls=np.zeros((4, 7), np.float32), fps=30.0)
    given = ["rig=toy", f"clip={tmp_path / 'take.npz'}", f"out={tmp_path / 'out'}"]
    refused(run("missing", *TOY, *given), "give meshes of the clip")


@pytest.mark.slow
def test_correctives_of_a_production_face_are_found_in_its_animation(tmp_path, monkeypatch):
    """Of 20 that were taken away, at random, and that move more than 1 mm; with known and with solved controls."""
    monkeypatch.syspath_prepend(ROOT / "examples/studio_face")
    from studio_face.convert import convert

    convert(*(shared(f"aura/{name}") for name in ("shapes.npz", "logic.json", "animation.npz")), tmp_path / "whole")
    table, take = np.load(tmp_path / "whole/deltas.npz"), np.load(tmp_path / "whole/takes/shapes.npz")
    (tmp_path / "less").mkdir()
    shutil.copy(tmp_path / "whole/neutral.obj", tmp_path / "less")
    whole = ShapesRig(str(tmp_path / "whole"), unit_mm=10)
    columns = [take["names"].tolist().index(name) for name in whole.control_names]
    controls = torch.tensor(take["controls"][::7, columns])
    largest = whole.basis.norm(dim=2).amax(dim=1) * whole.coefficients(controls).amax(dim=0)
    parts = {part for members in whole.shapes.combinations.values() for part in members}
    moving = [name for name, size in zip(whole.coefficient_names[72:], largest[72:]) if size > 1 and name not in parts]
    gone = set(np.random.default_rng(0).choice(moving, 20, replace=False).tolist())
    np.savez(tmp_path / "less/deltas.npz", **{name: delta for name, delta in table.items() if name not in gone})
    less, meshes = ShapesRig(str(tmp_path / "less"), unit_mm=10), whole(controls)
    found = find_missing(less, meshes, controls, 24, 4, known=True)
    true = {tuple(sorted(name.split("_"))): whole.basis[whole.coefficient_names.index(name)].flatten() for name in gone}
    assert sum(cosine > 0.9 for cosine in cosines(found, true)) >= 16
    assert float(found.after_mm.mean()) < 0.2 * float(found.before_mm.mean())
    solved = LevenbergMarquardt(RigInMeshSpace(less, MeshSpace.from_rig(less)), sparsity=2e-5)
    found = find_missing(less, meshes, solved.invert(StoredMeshes("take", meshes, 30.0)), 24, 4)
    assert len(cosines(found, true)) >= 10
    assert float(found.after_mm.mean()) < 0.2 * float(found.before_mm.mean())


def cosines(found, true):
    """Of the shapes whose drivers are right, with the true shapes."""
    pairs = [(true.get(tuple(sorted(driver.name.split("_")))), shape) for driver, shape in zip(found.rig.drivers, found.shapes)]
    return [float(torch.cosine_similarity(one, shape.flatten(), dim=0)) for one, shape in pairs if one is not None]
