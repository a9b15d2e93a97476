"""Hostile files for every load path: nothing in them runs, and each is refused in one sentence."""

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from riginv.config.building import OURS, build
from riginv.evaluation.models import load_model
from riginv.inference.bundle import copy_bundle, read_bundle
from riginv.inference.inverse import load_inverse
from riginv.rig.interface import RigBackend
from riginv.runs.checksums import sha256
from riginv.runs.files import read_yaml
from riginv.runs.run_folder import find_run_folder
from riginv.tracking.control_names import read_mask
from riginv.training.checkpoints import AtomicCheckpoints
from tests.fuzz.bundles import write_tiny_bundle, write_tiny_checkpoint, write_tiny_surrogate
from tests.inference.test_bundle import rewrite_sums
from tests.support import hostile
from tests.support.hostile import sentence
from tests.support.toys import ToyRig


def described(bundle: Path, change: Callable[[dict], None]) -> Path:
    """A bundle whose description says something else, with checksums that fit."""
    description = yaml.safe_load((bundle / "bundle.yaml").read_text())
    change(description)
    (bundle / "bundle.yaml").write_text(yaml.safe_dump(description))
    rewrite_sums(bundle)
    return bundle


RIGS = [
    lambda mark: {"_target_": "os.system", "command": f"touch {mark}"},
    lambda mark: {"_target_": "subprocess.Popen", "args": ["touch", str(mark)]},
    lambda mark: {"_target_": "builtins.exec", "source": f"open({str(mark)!r}, 'w')"},
    lambda mark: {"_target_": "riginv.runs.files.shutil.copyfile", "src": "/etc/hostname", "dst": str(mark)},
    lambda mark: {"_target_": "riginv.inference.bundle.Path", "path": str(mark)},
    hostile.script_of,
    lambda mark: {"_target_": "rigs.face.FaceRig", "anything": hostile.script_of(mark)},
    lambda mark: {"_target_": "rigs.shapes.ShapesRig", "folder": [hostile.script_of(mark)]},
    lambda mark: {"_target_": "rigs.blender.pool.WorkerPool", "command": ["touch", str(mark)], "load": {}},
    lambda mark: {"_target_": "rigs.blender.clip.BlenderClip", "path": "a.abc", "interpreter": "touch"},
    lambda mark: {"_target_": "rigs.blender.in_blender.worker.Channel"},
    lambda mark: {"_target_": "riginv.runs.run_folder.RunFolder", "path": str(mark), "config": {}, "resumed": False},
    lambda mark: {"_target_": "..os.system"},
    lambda mark: {"_target_": "rigs.face. FaceRig"},
    lambda mark: {"_target_": ["rigs.face.FaceRig"]},
    lambda mark: {
        "_target_": "riginv.rig.interface.RigBackend",
        "name": "x",
        "controls": [],
        "rest_vertices": 3,
        "faces": None,
    },
    lambda mark: {"_target_": "riginv.rig.black_box.BlackBoxRig", "rig": "x", "basis": 5},
]


@pytest.mark.parametrize("number", range(len(RIGS)))
@pytest.mark.parametrize("place", ["rig", "network", "surrogate"])
def test_a_bundle_names_only_rigs_and_networks(tmp_path, mark, number, place):
    """`os.system`, programs that classes of ours start, and classes within arguments: none of them is made."""
    config = RIGS[number](mark)
    if place == "rig":
        bundle = described(write_tiny_bundle(tmp_path / "b"), lambda found: found["rig"].update(config=config))
        sentence(lambda: load_inverse(bundle))
    elif place == "network":
        bundle = described(write_tiny_bundle(tmp_path / "b"), lambda found: found.update(network=config))
        sentence(lambda: load_inverse(bundle, ToyRig(detail=1, arkit=True)))
    else:
        bundle = described(write_tiny_surrogate(tmp_path / "b"), lambda found: found["rig"].update(config=config))
        surrogate = load_model(bundle)
        sentence(lambda: build(surrogate.true_rig_config, kind=RigBackend, only=OURS))


def test_a_bundle_starts_no_program_of_its_own_choice(tmp_path, mark, monkeypatch):
    """What is for users to type, such as the Python that runs Blender, a bundle cannot say."""
    script = tmp_path / "blender"
    script.write_text(f"#!/bin/sh\ntouch {mark}\n")
    script.chmod(0o755)
    (tmp_path / "a.blend").write_bytes(b"BLENDER" + bytes(64))
    monkeypatch.delenv("RIGINV_BLENDER", raising=False)
    config = {"_target_": "rigs.blender.rig.BlenderRig", "file": str(tmp_path / "a.blend"), "interpreter": str(script)}
    config |= {"scripts": True, "workers": 500, "timeout_s": 1e9}
    bundle = described(write_tiny_bundle(tmp_path / "b"), lambda found: found["rig"].update(config=config))
    sentence(lambda: load_inverse(bundle))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.update(kind="other"), "kind is 'other'"),
        (lambda d: d.update(network=[1]), "network"),
        (lambda d: d.update(rig="face"), "rig is 'face'"),
        (lambda d: d["rig"].update(controls=[{"name": "a"}] * 7), "lower is missing"),
        (lambda d: d["rig"]["controls"][0].update(more=1), "more than"),
        (lambda d: d["rig"]["controls"][0].update(name=5), "name is 5"),
        (lambda d: d["rig"].update(primary_count=99), "primary_count is 99"),
        (lambda d: d["training"].update(seconds=[]), "seconds"),
        (lambda d: d["network"].update(hidden="x" * 5), "hidden"),
        (lambda d: d["network"].update(hidden=[2**70]), "DirectInverse"),
        (lambda d: d["network"].update(hidden={"_target_": "os.system"}), "not allowed"),
        (lambda d: d["network"].update(__class__=1), "argument"),
    ],
)
def test_a_description_that_was_altered_with_care_is_refused(tmp_path, change, says):
    bundle = described(write_tiny_bundle(tmp_path / "b"), change)
    sentence(lambda: load_inverse(bundle, ToyRig(detail=1, arkit=True)), says)


@pytest.mark.parametrize("name", ["../secret", "/etc/hostname", "link", "rig/../../secret", "nul\0byte", "x" * 5000, ""])
def test_sums_and_links_lead_nowhere(tmp_path, name):
    (tmp_path / "secret").write_text("secret")
    bundle = write_tiny_bundle(tmp_path / "b")
    (bundle / "link").symlink_to(tmp_path / "secret")
    with (bundle / "SHA256SUMS").open("a") as sums:
        sums.write(f"{sha256(tmp_path / 'secret')}  {name}\n")
    sentence(lambda: read_bundle(bundle), "SHA256SUMS|missing")


def test_a_copied_bundle_brings_along_what_it_lists_and_nothing_that_a_link_leads_to(tmp_path):
    """An inverse that is trained through a surrogate holds a copy of its bundle, and may be given away."""
    (tmp_path / "key").write_text("a private key")
    bundle = write_tiny_surrogate(tmp_path / "b")
    (bundle / "notes.txt").symlink_to(tmp_path / "key")
    (bundle / "rig").symlink_to(tmp_path)
    copy_bundle(read_bundle(bundle).folder, tmp_path / "copy")
    assert sorted(path.name for path in (tmp_path / "copy").rglob("*")) == sorted(
        ["SHA256SUMS", "bundle.yaml", "space.safetensors", "weights.safetensors"]
    )
    assert read_bundle(tmp_path / "copy").description == read_bundle(bundle).description


@pytest.mark.parametrize("header", [b"\xff" * 8, (2**40).to_bytes(8, "little"), (60).to_bytes(8, "little") + b"{" * 60])
def test_headers_of_safetensors_that_promise_too_much(tmp_path, header):
    bundle = write_tiny_bundle(tmp_path / "b")
    for name in ("weights.safetensors", "space.safetensors"):
        whole = (bundle / name).read_bytes()
        (bundle / name).write_bytes(header + whole[8:])
        rewrite_sums(bundle)
        sentence(lambda: read_bundle(bundle), "cannot be read")
        (bundle / name).write_bytes(whole)


def test_checkpoints_hold_tensors_and_values_or_are_refused(tmp_path, mark):
    path = write_tiny_checkpoint(tmp_path / "last.ckpt")
    AtomicCheckpoints().load_checkpoint(path)
    hostile.torch_bomb(path, mark)
    sentence(lambda: AtomicCheckpoints().load_checkpoint(path), "no checkpoint of plain tensors")
    path.write_bytes(hostile.bomb(mark))
    sentence(lambda: AtomicCheckpoints().load_checkpoint(path), "no checkpoint of plain tensors")


def test_a_run_whose_checkpoint_is_a_bomb_is_not_gone_on_with(run, mark):
    short = ["trainer.max_steps=1", "data.batch_size=2", "evaluation.test_poses=2", "checkpoint.every_n_steps=1"]
    folder = run("train", *short).folder
    (folder / "metrics.json").unlink()  # as if it had been stopped
    hostile.torch_bomb(folder / "checkpoints/last.ckpt", mark)
    outcome = run("train", *short, "resume=true")  # refused, or trained anew without it
    assert "last.ckpt" in outcome.text and "Traceback" not in outcome.text


@pytest.mark.parametrize("name", ["bundle.yaml", "config.yaml", "mask.yaml"])
def test_tags_of_yaml_make_no_objects(tmp_path, mark, name):
    text = hostile.yaml_run(mark)
    if name == "bundle.yaml":
        bundle = write_tiny_bundle(tmp_path / "b")
        (bundle / name).write_text(text)
        rewrite_sums(bundle)
        sentence(lambda: read_bundle(bundle), "plain values")
    elif name == "config.yaml":
        (tmp_path / name).write_text(hostile.signed(text))
        sentence(lambda: find_run_folder(tmp_path, {"seed": 0}, resume=True), "plain values")
    else:
        (tmp_path / name).write_text(text)
        sentence(lambda: read_mask(tmp_path / name), "mask")


def test_a_config_that_multiplies_itself_is_refused_at_once(tmp_path):
    """Ten aliases of ten, thirty times over: 10^30 values from a kilobyte."""
    lines = ["a0: &a0 [1, 1]"] + [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 31)]
    (tmp_path / "config.yaml").write_text("\n".join(lines))
    sentence(lambda: read_yaml(tmp_path / "config.yaml"), "could be meant")
    (tmp_path / "config.yaml").write_text("[" * 5000)
    sentence(lambda: read_yaml(tmp_path / "config.yaml"), "config.yaml")
