"""DNA files as rigs: controls, meshes, units, axes, levels of detail, bases, and the usual commands."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from riginv.errors import InputError
from riginv.geometry.interpolation import coefficients_from, informative_vertices
from riginv.rig.arkit import ARKIT_NAMES
from riginv.rig.black_box import BlackBoxRig
from riginv.rig.contract import check_rig, random_controls
from riginv.rig.interface import LinearRig
from rigs.dna import DnaRig
from rigs.dna.exports import draft_of
from rigs.dna.format.later_layers import Conventions
from rigs.dna.format.layers import Axes, Behavior, Definition, Descriptor, Geometry, Vectors
from rigs.dna.linear import MOST_COEFFICIENTS
from rigs.dna.rig import LinearDnaRig
from tests.rigs.dna.files import changed, draft, everything, written
from tests.rigs.dna.heads import blendshape_head, many_joints


@pytest.fixture
def path(tmp_path) -> str:
    return written(tmp_path / "tiny.dna", everything())


@pytest.mark.parametrize("controls", ["gui", "raw"])
@pytest.mark.parametrize("lod", [0, 1])
def test_a_rig_keeps_the_contract(path, controls, lod):
    rig = DnaRig(path, controls, lod)
    check_rig(rig)
    assert isinstance(rig, LinearDnaRig)
    assert [name for name, _, _ in rig.parts] == (["skin", "teeth"] if lod == 0 else ["coarse"])


def test_controls_are_named_and_bounded_by_the_file(path):
    gui, raw = DnaRig(path, "gui"), DnaRig(path, "raw")
    quaternion = ("drv.qx", "drv.qy", "drv.qz", "drv.qw")
    assert gui.control_names == ("g0", "g1", "g2", "g3", *quaternion) and DnaRig(path).control_names == gui.control_names
    assert raw.control_names == (*(f"r{number}" for number in range(8)), *quaternion)
    assert gui.lower.tolist() == [0, -1, 0, 0, -1, -1, -1, -1] and gui.upper.tolist() == [1] * 8
    assert gui.neutral_controls.tolist() == [0] * 7 + [1]
    controls = random_controls(gui, 5, 0)
    torch.testing.assert_close(gui(controls), raw(gui.raw_controls(controls)), atol=1e-4, rtol=0)
    twice = controls.clone()
    twice[:, 4:] *= 0.3  # quaternions count as if they were of length 1
    torch.testing.assert_close(gui(controls), gui(twice), atol=1e-3, rtol=0)


def test_a_file_without_a_table_has_raw_controls(tmp_path):
    found = draft()
    found.rows = []
    path = written(tmp_path / "a.dna", found.file())
    assert DnaRig(path).control_names == tuple(found.raw)
    with pytest.raises(InputError, match="none of its 5 GUI controls is used by its table: choose rig.controls=raw"):
        DnaRig(path, "gui")


def test_meshes_are_chosen_by_globs(path):
    assert [part[0] for part in DnaRig(path, meshes=["te*"]).parts] == ["teeth"]
    assert len(DnaRig(path, meshes=["te*"]).rest_vertices) == 42
    with pytest.raises(InputError, match="no mesh of level of detail 0 is called so; they are: skin, teeth"):
        DnaRig(path, meshes=["coarse"])


def test_units_are_honoured_and_doubted(tmp_path, path):
    file = everything()
    metres = written(tmp_path / "m.dna", changed(file, Descriptor, translation_unit=1))
    with pytest.raises(InputError, match="mm large where coordinates are metres, as the file states.*rig.unit_mm=10"):
        DnaRig(metres)
    given = DnaRig(metres, "raw", unit_mm=10)
    controls = random_controls(given, 3, 0)
    torch.testing.assert_close(given(controls), DnaRig(path, "raw")(controls))
    larger = DnaRig(path, "raw", unit_mm=30)
    torch.testing.assert_close(larger(controls), 3 * given(controls), rtol=1e-5, atol=1e-2)
    unknown = written(tmp_path / "u.dna", changed(file, Descriptor, translation_unit=7))
    with pytest.raises(InputError, match=r"its unit of length is number 7, expected 0 \(cm\) or 1 \(m\)"):
        DnaRig(unknown)


def turned(vectors: Vectors, axes: np.ndarray) -> Vectors:
    return Vectors(*(np.stack([vectors.xs, vectors.ys, vectors.zs], axis=1) @ axes.T).T.astype(np.float32))


OTHER_AXES = {(0, 4, 2): [[-1, 0, 0], [0, 0, 1], [0, 1, 0]], (4, 1, 2): [[0, 0, 1], [1, 0, 0], [0, 1, 0]]}


@pytest.mark.parametrize("numbers", OTHER_AXES)
def test_axes_are_honoured(tmp_path, numbers):
    """The same character written along other axes is the same rig; a mirrored system turns faces round."""
    found = draft()
    for joint in range(len(found.joints)):
        found.joints[joint] = found.joints[joint]._replace(rotation=(0, 0, 0))
    moves = [np.array(group.attributes)[:, None] % 9 < 3 for group in found.groups]
    found.groups = [group._replace(values=np.where(one, group.values, 0)) for one, group in zip(moves, found.groups)]
    file, axes = found.file(), np.array(OTHER_AXES[numbers], dtype=float)  # file coordinates = axes @ riginv's
    meshes = []
    for mesh in file.need(Geometry).meshes:
        targets = tuple(dataclasses.replace(target, deltas=turned(target.deltas, axes)) for target in mesh.targets)
        meshes.append(dataclasses.replace(mesh, positions=turned(mesh.positions, axes), targets=targets))
    groups = []
    for group in file.need(Behavior).joints.groups:
        values = group.values.reshape(len(group.outputs), -1).copy()
        for joint in np.unique(group.outputs // 9):
            rows = [int(np.flatnonzero(group.outputs == 9 * joint + axis)[0]) for axis in range(3)]
            values[rows] = axes @ values[rows]
        groups.append(dataclasses.replace(group, values=values.reshape(-1)))
    joints = dataclasses.replace(file.need(Behavior).joints, groups=tuple(groups))
    other = changed(file, Geometry, meshes=tuple(meshes))
    other = changed(other, Behavior, joints=joints)
    other = changed(other, Definition, neutral_translations=turned(file.need(Definition).neutral_translations, axes))
    other = changed(other, Descriptor, axes=Axes(*numbers))
    one, two = DnaRig(written(tmp_path / "a.dna", file)), DnaRig(written(tmp_path / "b.dna", other))
    controls = random_controls(one, 4, 0)
    torch.testing.assert_close(one(controls), two(controls), atol=1e-3, rtol=0)
    same = bool(np.linalg.det(axes) > 0)
    assert torch.equal(two.faces, one.faces if same else one.faces.flip(1))


def test_clockwise_faces_are_turned_round(tmp_path):
    file = everything()
    conventions = file.need(Conventions)
    one = DnaRig(written(tmp_path / "a.dna", file))
    two = DnaRig(written(tmp_path / "b.dna", changed(file, Conventions, winding=0)))
    assert conventions.winding == 1 and torch.equal(one.faces, two.faces.flip(1))


def test_a_blendshape_head_is_a_blendshape_rig(tmp_path):
    rig = DnaRig(written(tmp_path / "head.dna", blendshape_head().file()))
    assert rig.has_blendshapes and rig.primary_count == 4 and rig.model.skeleton.levels == []
    assert rig.coefficient_names == ("jawOpen", "mouthSmileLeft", "mouthSmileRight", "blink", "jawOpen50", "jawOpen_smiles")
    assert set(rig.arkit_deltas()) == {"jawOpen", "mouthSmileLeft", "mouthSmileRight"} <= set(ARKIT_NAMES)
    controls = torch.tensor([[0.5, 0.0, 0.0], [1.0, -0.5, 0.25], [0.75, 1.0, 0.0]])
    expected = [[0.5, 0, 0, 0, 1, 0], [1, 0, 0.5, 0.25, 0, 0], [0.75, 1, 0, 0, 0.5, 0.75]]
    torch.testing.assert_close(rig.coefficients(controls), torch.tensor(expected))
    check_rig(rig)


def test_many_joints_are_fitted_by_the_vertices_that_tell_most(tmp_path, caplog):
    rig = DnaRig(written(tmp_path / "many.dna", many_joints().file()))
    assert not isinstance(rig, LinearRig) and rig.differentiable and rig.poses_subsets
    check_rig(rig)
    with caplog.at_level("INFO"):
        fitted = BlackBoxRig.sampled(rig, samples=150, residual_mm=0.05)
    assert "coefficients, fitted to poses to" in caplog.text and 0 < len(fitted.some_rest) * 3 <= len(rig.rest_vertices)
    controls = random_controls(rig, 20, 5).requires_grad_()
    whole = fitted.coefficients_of(rig(controls))
    away = fitted.rest_vertices + torch.einsum("bk,kvc->bvc", fitted.coefficients(controls), fitted.basis) - rig(controls)
    assert away.norm(dim=2).mean() < 0.1
    spread = whole.std(dim=0)
    assert ((fitted.coefficients(controls) - whole) / spread).abs().mean() < 0.2
    fitted.coefficients(controls).sum().backward()
    assert torch.isfinite(controls.grad).all() and controls.grad.abs().sum() > 0
    again = BlackBoxRig(rig, fitted.basis).double().coefficients(controls.detach().double()).float()
    torch.testing.assert_close(again, fitted.coefficients(controls), atol=1e-2, rtol=0)


@pytest.mark.parametrize("file", [everything(operations=True), many_joints().file()], ids=["linear", "fitted"])
def test_forward_derivatives_are_those_of_the_gradient(tmp_path, file):
    rig = DnaRig(written(tmp_path / "a.dna", file), "raw").double()
    fitted = rig if isinstance(rig, LinearRig) else BlackBoxRig(rig, torch.randn(9, *rig.rest_vertices.shape).double())
    controls = random_controls(rig, 3, 0).double()
    found, jacobian = fitted.coefficient_jacobian(controls)
    expected, reverse = LinearRig.coefficient_jacobian(fitted, controls)
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(jacobian.dense(), reverse.dense(), atol=1e-8, rtol=1e-6)


def test_some_vertices_are_those_of_the_whole_mesh(tmp_path):
    rig = DnaRig(written(tmp_path / "many.dna", many_joints().file()))
    rows = torch.tensor([0, 7, 31, 200])
    controls = random_controls(rig, 3, 0)
    torch.testing.assert_close(rig.vertex_subset(rows)(controls), rig(controls)[:, rows])


def test_telling_vertices_tell_the_coefficients_of_meshes():
    frame = torch.linalg.qr(torch.randn(900, 12, dtype=torch.float64))[0].T.reshape(12, 300, 3)
    rows = informative_vertices(frame)
    coefficients = torch.randn(5, 12, dtype=torch.float64)
    meshes = torch.einsum("bk,kvc->bvc", coefficients, frame)
    assert len(rows) <= 24
    torch.testing.assert_close(meshes[:, rows].flatten(1) @ coefficients_from(frame, rows), coefficients)


def test_the_linear_map_is_what_skinning_makes(path):
    rig = DnaRig(path, "raw")
    assert len(rig.basis) <= MOST_COEFFICIENTS and rig.primary_count == 0
    controls = random_controls(rig, 5, 3)
    torch.testing.assert_close(rig(controls), rig.model(rig.mapping(controls)), atol=1e-3, rtol=0)
    assert len(rig.coefficient_names) == len(rig.basis) and "joint 3.00 c0" in rig.coefficient_names


def test_a_character_of_joints_alone_tells_its_skeleton(body, tmp_path):
    rig = DnaRig(written(tmp_path / "body.dna", draft_of(body).file()))
    ours, theirs = rig.skeleton(), body.skeleton()
    assert ours is not None and set(ours.joint_names) <= set(theirs.joint_names) and ours.parents[0] == -1
    assert all(parent < joint for joint, parent in enumerate(ours.parents))
    order = [theirs.joint_names.index(name) for name in ours.joint_names]
    controls = random_controls(body, 3, 0)
    torch.testing.assert_close(ours.pose(controls), theirs.pose(controls)[:, order], atol=5e-3, rtol=0)
    torch.testing.assert_close(ours.weights, theirs.weights[:, order], atol=1e-6, rtol=0)
    neutral = ours.pose(rig.neutral_controls[None])[0]
    torch.testing.assert_close(neutral[..., :3], torch.eye(3).expand(len(order), 3, 3), atol=1e-5, rtol=0)
    torch.testing.assert_close(neutral[..., 3], ours.heads, atol=1e-3, rtol=0)
    assert DnaRig(written(tmp_path / "tiny.dna", everything())).skeleton() is None


@pytest.mark.parametrize("file", [pytest.param("linear", marks=pytest.mark.slow), "fitted"])
def test_a_rig_trains_is_evaluated_and_inverted_by_the_usual_commands(run, tmp_path, file):
    content = everything() if file == "linear" else many_joints().file()
    written(tmp_path / "a.dna", content)
    small = ["model.network.hidden=[32]", "model.network.refinement_steps=1", "trainer.max_steps=6", "data.steps_per_epoch=6"]
    small += ["data.batch_size=8", "evaluation.test_poses=8", "evaluation.validation_poses=4"]
    small += [
        "pictures.every_n_validations=null",
        "pictures.final=false",
        "mesh_space.samples=60",
        "mesh_space.residual_mm=0.1",
    ]
    made = run("train", "rig=dna", "rig.file=a.dna", "model=inverse", *small, small=False)
    assert made.code == 0, made.text
    assert made.metrics["true_rig"] == "a" and "rig_poses/mean_vertex_error_mm" in made.metrics
    again = run("evaluate", f"bundle={made.folder}", "poses=8", "refine=1", small=False, folder="again")
    assert again.code == 0, again.text
    assert ("rig_poses/optimum_is_bound" in made.metrics) == (file == "fitted")
    assert 0 < made.metrics["rig_poses/optimum_mean_vertex_error_mm"] < made.metrics["rig_poses/mean_vertex_error_mm"]
    assert run("check", "rig=dna", "rig.file=a.dna").code == 0
    rig = DnaRig(str(tmp_path / "a.dna"))
    np.savez(tmp_path / "clip.npz", vertices=rig(random_controls(rig, 4, 0)).numpy(), faces=rig.faces.numpy())
    inverted = run("invert", f"bundle={made.folder}", "clip=clip.npz", "out=curves", "formats=[csv]")
    assert inverted.code == 0, inverted.text
    assert (tmp_path / "curves/curves.csv").read_text().startswith("frame,seconds," + ",".join(rig.control_names))
    errors = json.loads((tmp_path / "curves/curves.json").read_text())["errors"]
    assert errors["least_mean_error_mm"] <= errors["mean_error_there_mm"]
    assert ("least_error_is_bound" in errors) == ("in a fitted basis" in inverted.text) == (file == "fitted")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"controls": "both"}, "rig.controls is 'both', expected gui, raw or null"),
        ({"lod": -1}, "rig.lod is -1, expected a whole number"),
        ({"lod": 2}, "rig.lod=2, expected 0 to 1"),
        ({"meshes": "skin"}, "rig.meshes is 'skin', expected a list of globs"),
        ({"unit_mm": 0}, "rig.unit_mm is 0, expected a number above 0"),
        ({"unit_mm": True}, "rig.unit_mm is True"),
    ],
)
def test_arguments_that_cannot_be_meant_are_refused(path, arguments, message):
    with pytest.raises(InputError, match=message):
        DnaRig(path, **arguments)
