"""The default rigs and their Blender twins: the same logic, written down, rebuilt and evaluated elsewhere."""

import itertools
import os
import stat

import numpy as np
import pytest
import torch

from riginv.errors import InputError
from riginv.evaluation.evaluation_sets import random_poses
from riginv.rig.contract import check_rig
from rigs.blender.blueprint import unpack_curves
from rigs.blender.body import body_blueprint
from rigs.blender.face import face_blueprint
from rigs.blender.interpreter import VARIABLE, find_interpreter, script_command
from rigs.blender.rig import BlenderRig
from rigs.blender.twin import blueprint_of, twin_file
from rigs.body import BodyRig
from tests.config.test_bad_input import refused
from tests.support.blends import blender
from tests.support.toys import ToyRig

NEAR_MM, FAR_MM = 0.001, 0.01  # on average, and at most


@pytest.fixture(scope="module")
def body():
    return BodyRig()


def bezier(curve, x):
    """The value of a driven key at x, by bisection."""
    if x <= curve[0].x:
        return curve[0].y
    for start, end in itertools.pairwise(curve):
        if x <= end.x:
            xs = np.array([start.x, start.x + start.right[0], end.x + end.left[0], end.x])
            ys = np.array([start.y, start.y + start.right[1], end.y + end.left[1], end.y])
            low, high = 0.0, 1.0
            for _ in range(60):
                t = (low + high) / 2
                basis = np.array([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3])
                low, high = (t, high) if basis @ xs < x else (low, t)
            return float(basis @ ys)
    return curve[-1].y


def computed(blueprint, controls):
    """All values of a blueprint for one pose, in plain Python."""
    pose, values = dict(zip([control.name for control in blueprint.controls], controls)), {}
    for value in blueprint.values:
        inputs = [(pose if value.of_controls else values)[name] for name in value.inputs]
        result = {
            "sum": np.dot(value.factors or np.ones(len(inputs)), inputs),
            "product": np.prod(inputs),
            "screen": 1 - np.prod(1 - np.array(inputs)),
            "least": min(inputs),
        }[value.operation]
        values[value.name] = bezier(value.curve, result) if value.curve else result
    return values


def test_the_faces_blueprint_gives_the_weights_of_the_face(face):
    blueprint = face_blueprint(face)
    controls = random_poses(face, 5).controls.double()
    weights = face.coefficients(controls)
    for row, expected in zip(controls.tolist(), weights):
        values = computed(blueprint, row)
        found = torch.tensor([values[shape] for shape in blueprint.shapes], dtype=torch.float64)
        torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)  # the face's curves are float32


def test_the_bodys_blueprint_turns_its_joints(body):
    blueprint = body_blueprint(body)
    assert blueprint.skeleton.names == tuple(body.joint_names) and not blueprint.shapes
    controls = random_poses(body, 1).controls.double()
    values = computed(blueprint, controls[0].tolist())
    for name, channel in blueprint.skeleton.channels.items():
        if channel.kind == "rotation":
            column = 3 * body.joint_names.index(channel.joint) + int(name[-1])
            assert values[name] == pytest.approx(float(controls[0] @ body.angles.double()[:, column]), abs=1e-6)


def test_curves_come_back_as_they_were_packed(face):
    from riginv.geometry.curves import evaluate_curves, pack_curves

    for table in (face.limit_curves.double(), face.inbetween_curves.double()):
        inputs = 3 * torch.rand(50, len(table), dtype=torch.float64)
        again = pack_curves(unpack_curves(table))
        torch.testing.assert_close(
            evaluate_curves(again, inputs), evaluate_curves(table, inputs), atol=1e-6, rtol=0
        )  # float32 inside


def test_a_rig_changes_its_hash_with_its_content(face):
    before = face_blueprint(face).content_hash()
    assert face_blueprint(face).content_hash() == before
    face.basis[3, 5, 1] += 1e-3
    try:
        assert face_blueprint(face).content_hash() != before
    finally:
        face.basis[3, 5, 1] -= 1e-3


def test_only_the_default_rigs_have_a_twin():
    with pytest.raises(InputError, match=r"rig 'toy' cannot be rebuilt in Blender"):
        blueprint_of(ToyRig())


@pytest.mark.parametrize("name", ["face", "body"])
def test_a_default_rig_and_its_twin_agree(name, request):
    program, rig = blender(), request.getfixturevalue(name)
    twin = BlenderRig(interpreter=program, twin_of=rig)
    assert twin.control_names == rig.control_names and twin.control_names[0] == twin.found_names[0]
    for ours, theirs in ((rig.lower, twin.lower), (rig.upper, twin.upper), (rig.neutral_controls, twin.neutral_controls)):
        torch.testing.assert_close(ours, theirs)
    assert torch.equal(rig.faces.sort(dim=1).values, twin.faces.sort(dim=1).values)
    controls = torch.cat([random_poses(rig, 40).controls, rig.lower[None], rig.upper[None], rig.neutral_controls[None]])
    errors = (twin(controls).double() - rig.double()(controls.double())).norm(dim=2)
    rig.float()
    assert errors.mean() <= NEAR_MM and errors.max() <= FAR_MM
    assert twin.arkit_deltas().keys() == rig.arkit_deltas().keys() and twin.expressions() == rig.expressions()
    twin.pool.close()


def test_the_twin_of_the_face_keeps_the_contract_and_is_built_once(face):
    twin = BlenderRig(interpreter=blender(), twin_of=face)
    check_rig(twin)
    path = twin_file(face, "a program that is not there")
    assert path.is_file() and twin_file(face, "nor this one") == path
    twin.pool.close()


def test_evaluate_compares_a_rig_with_its_twin(run):
    blender()
    outcome = run("evaluate", "rig=face", "true_rig=blender", "poses=20")
    assert outcome.code == 0, outcome.text
    assert outcome.metrics["rig_agreement/mean_vertex_error_mm"] <= NEAR_MM
    assert outcome.metrics["rig_agreement/max_vertex_error_mm"] <= FAR_MM
    assert outcome.metrics["true_rig"] == "face in Blender"


def test_without_blender_a_sentence_says_how_to_get_it(run, monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    refused(run("check", "rig=blender", "rig.file=a.blend"), "pip install 'riginv[blender]'", "rig.interpreter=PATH")
    refused(run("check", "rig=blender", "rig.interpreter=/no/blender"), "rig.interpreter=/no/blender: there is no such program")
    monkeypatch.setenv(VARIABLE, "/no/python")
    refused(run("check", "rig=blender", "rig.file=a.blend"), f"{VARIABLE}=/no/python: there is no such program")


def test_what_a_user_must_give_is_said(run, monkeypatch):
    monkeypatch.setenv(VARIABLE, "python3")
    refused(run("check", "rig=blender"), "rig.file must be given")
    refused(run("check", "rig=blender", "rig.file=none.blend"), "none.blend: no such file")


def test_a_bundle_cannot_name_a_program_to_run():
    from riginv.config.building import OURS, build

    config = {"_target_": "rigs.blender.rig.BlenderRig", "file": "none.blend", "interpreter": "/bin/ls", "scripts": True}
    with pytest.raises(InputError) as error:
        build(config, only=OURS)
    assert "/bin/ls" not in str(error.value)


@pytest.mark.skipif(os.name == "nt", reason="a shell script")
def test_blender_itself_may_run_the_worker(face, tmp_path):
    python, program = blender(), tmp_path / "blender-4.5"
    program.write_text(f"""#!/bin/sh
# What Blender does with these options: it prints a banner, runs the script, and leaves the rest to it.
echo "Blender 4.5.15"
[ "$1 $2 $3 $4 $5" = "--background --factory-startup --python-exit-code 1 --python" ] || exit 3
shift 5
exec {python} "$@"
""")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    assert script_command(str(program), "worker.py")[1] == "--background"
    rig = BlenderRig(str(twin_file(face, python)), interpreter=str(program), workers=1)
    assert rig.control_names == face.control_names
    rig.pool.close()
    assert find_interpreter(str(program)) == str(program)


def test_export_writes_a_file_that_opens_as_the_same_rig(face, tmp_path, monkeypatch, capfd):
    import sys

    from hydra.core.global_hydra import GlobalHydra

    from riginv.launch.command import command
    from rigs.blender.export import export

    blender()
    GlobalHydra.instance().clear()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["rigs.blender.export", "rig=face", "out=face.blend"])
    command("export_blender")(export)()
    assert "628 shape keys" in " ".join(capfd.readouterr().out.split())
    rig = BlenderRig("face.blend", include=["jawOpen"], workers=1)
    jaw = torch.ones(1, 1)
    expected = face(
        torch.nn.functional.one_hot(torch.tensor([face.control_names.index("jawOpen")]), len(face.controls)).float()
    )
    torch.testing.assert_close(rig(jaw), expected, atol=FAR_MM, rtol=0)
    rig.pool.close()
    GlobalHydra.instance().clear()
    monkeypatch.setattr(sys, "argv", ["rigs.blender.export", "rig=face", "out=face.obj"])
    with pytest.raises(SystemExit):
        command("export_blender")(export)()
    assert "ends in .blend" in " ".join(capfd.readouterr().err.split())
