"""Bundles: what was saved comes back, and what is damaged or foreign does not."""

import shutil
from pathlib import Path

import pytest
import torch
import yaml

from riginv.errors import InputError
from riginv.inference.bundle import read_bundle
from riginv.inference.inverse import load_inverse
from riginv.runs.checksums import sha256
from tests.support.toys import ToyRig


@pytest.fixture(scope="module")
def bundle(tmp_path_factory) -> Path:
    """An inverse of the toy, trained for a few steps."""
    import sys

    from hydra.core.global_hydra import GlobalHydra

    from riginv.launch.command import command
    from riginv.train import train
    from tests.conftest import SMALL

    folder = tmp_path_factory.mktemp("bundles") / "run"
    GlobalHydra.instance().clear()
    arguments, sys.argv = sys.argv, ["train", *SMALL, f"hydra.run.dir={folder}"]
    try:
        command("train")(train)()
    finally:
        sys.argv = arguments
        torch.use_deterministic_algorithms(False)
    return folder / "bundle"


def rewrite_sums(folder: Path) -> None:
    """Make a bundle look whole again after it was changed."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "SHA256SUMS")
    (folder / "SHA256SUMS").write_text("".join(f"{sha256(path)}  {path.relative_to(folder)}\n" for path in files))


def test_an_inverse_comes_back_and_answers_the_same(bundle):
    rig = ToyRig()
    inverse = load_inverse(bundle, rig)
    vertices = rig(torch.rand(5, 7) * 0.5)
    controls = inverse(vertices)
    assert controls.shape == (5, 7) and not controls.requires_grad
    again = load_inverse(bundle.parent, ToyRig())(vertices)  # the run's folder will do
    assert torch.equal(controls, again)
    torch.testing.assert_close(inverse(rig.rest_vertices[None])[0], rig.neutral_controls, atol=1e-5, rtol=0)


def test_a_rig_that_is_not_ours_is_not_built_from_a_bundle(bundle):
    with pytest.raises(InputError, match=r"tests\.support\.toys\.ToyRig is not allowed"):
        load_inverse(bundle)


def test_meshes_of_another_size_are_refused(bundle):
    with pytest.raises(InputError, match=r"needs \(mesh, 162, 3\)"):
        load_inverse(bundle, ToyRig())(torch.zeros(2, 161, 3))


@pytest.mark.parametrize("name", ["bundle.yaml", "weights.safetensors", "space.safetensors"])
@pytest.mark.parametrize("damage", ["missing", "truncated", "altered"])
def test_a_damaged_file_is_named(bundle, tmp_path, name, damage):
    copy = shutil.copytree(bundle, tmp_path / "copy")
    content = (copy / name).read_bytes()
    if damage == "missing":
        (copy / name).unlink()
    elif damage == "truncated":
        (copy / name).write_bytes(content[: len(content) // 2])
    else:
        (copy / name).write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(InputError, match=name):
        load_inverse(copy, ToyRig())


def test_damaged_sums_and_missing_bundles_are_named(bundle, tmp_path):
    copy = shutil.copytree(bundle, tmp_path / "copy")
    (copy / "SHA256SUMS").write_bytes((copy / "SHA256SUMS").read_bytes()[:30])
    with pytest.raises(InputError, match="SHA256SUMS"):
        read_bundle(copy)
    (copy / "SHA256SUMS").unlink()
    with pytest.raises(InputError, match="no bundle there"):
        read_bundle(copy)


def test_sums_cannot_point_outside_the_bundle(bundle, tmp_path):
    copy = shutil.copytree(bundle, tmp_path / "copy")
    (tmp_path / "outside").write_text("secret")
    with (copy / "SHA256SUMS").open("a") as sums:
        sums.write(f"{sha256(tmp_path / 'outside')}  ../outside\n")
    with pytest.raises(InputError, match="outside the bundle"):
        read_bundle(copy)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("format: 1", "format: 9"), "format 9"),
        (lambda text: text.replace("kind: inverse", "kind: forward"), "expected 'inverse'"),
        (lambda text: text.replace("riginv.networks.inverse.StagedInverse", "os.system"), "os.system is not allowed"),
        (lambda text: text.replace("riginv.networks.inverse.StagedInverse", "riginv.runs.files.os.system"), "not"),
        (lambda text: text.replace("hidden:\n", "hiden:\n"), "hiden"),
        (lambda text: text.replace("refinement_steps: null", "refinement_steps: 5"), "do not fit"),
        (lambda text: text + "\n: [", "cannot be read"),
        (lambda text: "!!python/object/apply:os.system ['true']", "cannot be read"),
    ],
)
def test_a_changed_description_is_refused_and_runs_nothing(bundle, tmp_path, change, says):
    copy = shutil.copytree(bundle, tmp_path / "copy")
    text = (copy / "bundle.yaml").read_text()
    assert change(text) != text
    (copy / "bundle.yaml").write_text(change(text))
    rewrite_sums(copy)
    with pytest.raises(InputError, match=says):
        load_inverse(copy, ToyRig())


@pytest.mark.parametrize(
    ("rig", "says"),
    [(lambda: ToyRig(last_name="other"), "control 6"), (lambda: ToyRig(detail=1), "42 vertices")],
)
def test_another_rig_is_told_apart(bundle, rig, says):
    with pytest.raises(InputError, match=says):
        load_inverse(bundle, rig())


def test_a_rig_with_fewer_controls_is_told_apart(bundle):
    class Fewer(ToyRig):
        def __init__(self):
            super().__init__()
            self.controls = self.controls[:6]

    with pytest.raises(InputError, match="6 controls, the bundle was trained on 7"):
        load_inverse(bundle, Fewer())


def test_the_description_says_what_was_trained(bundle):
    description = yaml.safe_load((bundle / "bundle.yaml").read_text())
    assert description["kind"] == "inverse" and description["rig"]["name"] == "toy"
    assert [control["name"] for control in description["rig"]["controls"]][-2:] == ["side", "all"]
    assert description["training"]["steps"] == 12
