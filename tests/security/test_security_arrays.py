"""Arrays from untrusted files: no objects, no bombs, no paths that lead out."""

import contextlib
import json
import os
import zipfile

import numpy as np
import pytest
import zarr

from riginv.errors import InputError
from riginv.rig.pairs import read_pairs, write_pairs
from riginv.runs.files import read_yaml
from riginv.tracking.regions import read_region
from rigs.shapes import ShapesRig
from tests.fuzz.readers import pair_arrays, read_clip
from tests.support import hostile, sculpts
from tests.support.hostile import sentence
from tests.support.toys import ToyRig

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
