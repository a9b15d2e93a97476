"""Hostile files for every load path: nothing in them runs, and each is refused in one sentence."""

import contextlib
import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
import zarr

from riginv.config.building import OURS, build
from riginv.errors import InputError
from riginv.evaluation.models import load_model
from riginv.inference.bundle import copy_bundle, read_bundle
from riginv.inference.inverse import load_inverse
from riginv.rig.interface import RigBackend
from riginv.rig.pairs import read_pairs, write_pairs
from riginv.runs.checksums import sha256
from riginv.runs.files import read_yaml
from riginv.runs.run_folder import find_run_folder
from riginv.tracking.control_names import read_mask
from riginv.tracking.regions import read_region
from riginv.training.checkpoints import AtomicCheckpoints
from rigs.shapes import ShapesRig
from tests.fuzz.bundles import write_tiny_bundle, write_tiny_checkpoint, write_tiny_surrogate
from tests.fuzz.readers import pair_arrays, read_clip
from tests.inference.test_bundle import rewrite_sums
from tests.support import hostile, sculpts
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
    short = ["trainer.max_steps=1", "data.batch_size=2", "judging.test_poses=2", "checkpoint.every_n_steps=1"]
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


ARRAYS = [  # what reads an .npy or an .npz, and whether it is the latter
    (lambda path: read_clip(path), "npz"),
    (lambda path: read_clip(path), "npy"),
    (lambda path: read_pairs(path), "npz"),
    (lambda path: read_region(path, 8), "npy"),
    (lambda path: ShapesRig(str(path.parent)), "npy"),
    (lambda path: ShapesRig(str(path.parent)), "npz"),
]


@pytest.mark.parametrize(("read", "ending"), ARRAYS)
def test_arrays_of_objects_are_never_loaded(tmp_path, own_cache, mark, read, ending):
    folder = sculpts.write_folder(tmp_path / "s")
    objects, path = hostile.object_npy(mark), folder / f"a.{ending}"
    names = [f"{name}.npy" for name in ("vertices", "faces", *pair_arrays())]
    if ending == "npy":
        path.write_bytes(objects)
    else:
        hostile.npz(path, dict.fromkeys(names, objects))
    sentence(lambda: read(path))
    path.write_bytes(hostile.bomb(mark))  # a bare pickle, which NumPy would take for one
    sentence(lambda: read(path))


@pytest.mark.parametrize(("read", "ending"), ARRAYS)
def test_arrays_that_promise_too_much_are_refused_before_they_are_made(tmp_path, own_cache, read, ending):
    folder = sculpts.write_folder(tmp_path / "s")
    liar = hostile.npy(np.zeros((2, 8, 3), np.float32)).replace(b"(2, 8, 3), }            ", b"(2000000000, 8, 3), }   ", 1)
    assert b"2000000000" in liar
    path = folder / f"a.{ending}"
    path.write_bytes(liar)
    if ending == "npz":
        hostile.npz(path, dict.fromkeys([f"{name}.npy" for name in pair_arrays()], liar))
    sentence(lambda: read(path))


def test_a_zip_bomb_is_refused_by_its_size(tmp_path, own_cache):
    """Zeros pack a thousand to one; nothing is unpacked to find out."""
    folder = sculpts.write_folder(tmp_path / "s")
    with zipfile.ZipFile(folder / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("controls.npy", hostile.npy(np.zeros((1 << 20, 4))))
        archive.infolist()[0].file_size = 1 << 40  # as if there were a terabyte of them
    for read in (read_pairs, lambda path: ShapesRig(str(path.parent))):
        sentence(lambda read=read: read(folder / "a.npz"), "a bomb, or damaged")


def test_names_in_a_zip_lead_nowhere(tmp_path):
    """Members are read in place; a name with ../ is a name."""
    meshes = hostile.npy(np.zeros((2, 42, 3), np.float32))
    hostile.npz(tmp_path / "a.npz", {"../../vertices.npy": meshes, "/etc/faces.npy": hostile.npy(np.zeros((0, 3), int))})
    before = sorted(tmp_path.parent.rglob("*"))
    sentence(lambda: read_pairs(tmp_path / "a.npz"), "no array 'controls'")
    try:
        read_clip(tmp_path / "a.npz")
    except InputError as refusal:
        assert "\n" not in str(refusal)
    assert sorted(tmp_path.parent.rglob("*")) == before


@pytest.mark.parametrize(
    ("array", "more"),
    [
        ("control_names", {"dtype": "|O", "filters": [{"id": "vlen-utf8"}, {"id": "pickle"}], "fill_value": ""}),
        ("vertices", {"filters": [{"id": "pickle"}]}),
        ("vertices", {"compressor": {"id": "pickle"}}),
    ],
)
def test_codecs_of_zarr_that_unpickle_are_never_run(tmp_path, mark, monkeypatch, array, more):
    """Even where numcodecs is told to allow it, as its older versions do unasked."""
    import numcodecs.pickles

    monkeypatch.setattr(numcodecs.pickles, "ALLOW_UNSAFE_PICKLE_DECODE", True, raising=False)
    write_pairs(tmp_path / "p.zarr", pair_arrays())
    header = tmp_path / f"p.zarr/{array}/.zarray"
    header.write_text(json.dumps({**json.loads(header.read_text()), "compressor": None, **more}))
    for chunk in (tmp_path / "p.zarr" / array).glob("[0-9]*"):
        chunk.write_bytes(hostile.bomb(mark))
    if array == "control_names":  # zarr itself would run it
        with contextlib.suppress(TypeError):  # what it made is no text
            zarr.open_group(tmp_path / "p.zarr", mode="r")[array][:]
        assert mark.exists()
        mark.unlink()
        sentence(lambda: read_pairs(tmp_path / "p.zarr"), "'pickle', which is never run")
    sentence(lambda: read_pairs(tmp_path / "p.zarr"))


def test_a_zarr_that_promises_more_than_it_holds_is_refused(tmp_path):
    write_pairs(tmp_path / "p.zarr", pair_arrays())
    header = tmp_path / "p.zarr/vertices/.zarray"
    content = json.loads(header.read_text())
    header.write_text(json.dumps({**content, "shape": [10**9, 42, 3]}))
    sentence(lambda: read_pairs(tmp_path / "p.zarr"), "promises")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_pipes_and_devices_are_never_opened(tmp_path):
    """A folder of frames whose second is a link to /dev/zero would be read without end."""
    faces = ToyRig(detail=1).faces.numpy()
    from tests.support.clips import write_obj

    write_obj(tmp_path / "shot.1.obj", ToyRig(detail=1).rest_vertices.numpy(), faces)
    (tmp_path / "shot.2.obj").symlink_to("/dev/zero")
    sentence(lambda: read_clip(tmp_path / "shot.%d.obj"), "device")
    for name in ("pipe.npz", "pipe.yaml", "pipe.csv"):
        os.mkfifo(tmp_path / name)
    sentence(lambda: read_clip(tmp_path / "pipe.npz"), "pipe")
    sentence(lambda: read_clip(tmp_path / "pipe.csv"), "pipe")
    sentence(lambda: read_yaml(tmp_path / "pipe.yaml"), "pipe")


def test_zarr_is_still_what_it_was(tmp_path):
    write_pairs(tmp_path / "p.zarr", pair_arrays())
    assert zarr.open_group(tmp_path / "p.zarr", mode="r")["controls"].shape == (6, 7)
    assert len(read_pairs(tmp_path / "p.zarr").controls) == 6
