"""Scenes of stale: .blend files with scripts, stages and avatars that point elsewhere. Nothing runs or is fetched."""

import json
import os
import socket
from pathlib import Path

import pytest

from riginv.errors import InputError
from rigs.gltf import GltfRig
from tests.fuzz.readers import read_clip, toy
from tests.support.blends import make_blend
from tests.support.clips import performance, write_animated_glb, write_obj, write_usd

SCRIPTS = """
text = bpy.data.texts.new("run.py")
text.write("open({mark!r}, 'w').close()")
text.use_module = True
thing = cube()
shape(thing, "smile", (1, 0, 0))
"""


@pytest.fixture
def elsewhere():
    """A server that nobody may call."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.2)
        yield f"http://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(TimeoutError):
            server.accept()


def stage(path: Path) -> Path:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    return write_usd(path, performance(toy(), 3), toy().faces.numpy())


def usda(path: Path, arcs: str, more: str = "") -> Path:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    path.write_text(f'#usda 1.0\n(\n    {more}\n)\ndef Mesh "head" (\n    {arcs}\n)\n{{\n}}\n')
    return path


ARCS = {
    "a reference": ("prepend references = @{0}@</world/head>", ""),
    "a payload": ("prepend payload = @{0}@</world/head>", ""),
    "a sublayer": ("", "subLayers = [@{0}@]"),
    "a clip": (
        'clips = {{ dictionary default = {{ asset[] assetPaths = [@{0}@]\n string primPath = "/world/head"\n '
        "double2[] active = [(0, 0)]\n double2[] times = [(0, 0)] }} }}",
        "",
    ),
    "a variant": ('variants = {{ string v = "a" }}\n    prepend variantSets = "v"', ""),
}


@pytest.mark.parametrize("arc", ["a reference", "a payload", "a sublayer", "a clip"])
@pytest.mark.parametrize("where", ["outside", "absolute", "url", "device", "link"])
def test_a_stage_is_made_of_layers_in_its_own_folder(tmp_path, arc, where, elsewhere):
    (tmp_path / "shot").mkdir()
    secret = stage(tmp_path / "secret.usda")
    (tmp_path / "shot/link.usda").symlink_to(secret)
    (tmp_path / "shot/zero.usda").symlink_to("/dev/zero")
    target = {
        "outside": "../secret.usda",
        "absolute": str(secret),
        "url": f"{elsewhere}/secret.usda",
        "device": "./zero.usda",
        "link": "./link.usda",
    }[where]
    arcs, more = (text.format(target) for text in ARCS[arc])
    path = usda(tmp_path / "shot/a.usda", arcs, more)
    with pytest.raises(InputError, match="own folder") as refusal:
        read_clip(path)
    assert "\n" not in str(refusal.value)


def test_layers_beside_a_stage_are_read(tmp_path):
    stage(tmp_path / "points.usda")
    path = usda(tmp_path / "a.usda", "prepend references = @./points.usda@</world/head>")
    assert len(read_clip(path)) == 3


def test_an_avatar_fetches_nothing(tmp_path, elsewhere):
    write_animated_glb(tmp_path / "a.gltf", performance(toy(), 3), toy().faces.numpy())
    document = json.loads((tmp_path / "a.gltf").read_text())
    for uri in (f"{elsewhere}/a.bin", "file:///etc/passwd", "//127.0.0.1/share/a.bin", "..\\a.bin", "a.bin\0", "../../a.bin"):
        document["buffers"][0]["uri"] = uri
        (tmp_path / "a.gltf").write_text(json.dumps(document))
        with pytest.raises(InputError, match=r"own folder|no such file"):
            GltfRig(str(tmp_path / "a.gltf"))


def test_materials_of_an_obj_are_never_opened(tmp_path, elsewhere):
    path = write_obj(tmp_path / "a.obj", toy().rest_vertices.numpy(), toy().faces.numpy())
    os.mkfifo(tmp_path / "pipe.mtl")  # who opened it would wait for ever
    path.write_text(f"mtllib pipe.mtl\nmtllib {elsewhere}/a.mtl\nmtllib /etc/passwd\nusemtl x\n" + path.read_text())
    assert len(read_clip(path)) == 1


def test_scripts_of_a_blend_do_not_run(tmp_path):
    """A text that registers itself; drivers that need Python are refused in test_blender_rig.py."""
    from rigs.blender.rig import BlenderRig

    path, ran = tmp_path / "a.blend", tmp_path / "ran"
    make_blend(path, SCRIPTS.format(mark=str(ran)))
    assert [control.name for control in BlenderRig(str(path), workers=1).controls] == ["smile"]
    assert not ran.exists()
    BlenderRig(str(path), workers=1, scripts=True)
    assert ran.exists()  # the payload is no dud


@pytest.mark.parametrize("where", ["../secret.usda", "{0}/secret.usda", "{1}/secret.usda"])
@pytest.mark.parametrize("layer", ["first", "second"])
def test_a_package_is_made_of_what_lies_in_it_and_beside_it(tmp_path, where, layer, elsewhere):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Sdf

    from tests.support.usd_stages import opened

    (tmp_path / "shot").mkdir()
    stage(tmp_path / "secret.usda")
    stage(tmp_path / "inner.usda")
    secret = f"prepend references = @{where.format(tmp_path, elsewhere)}@</world/head>"
    usda(tmp_path / "b.usda", secret if layer == "second" else "prepend references = @./inner.usda@</world/head>")
    usda(tmp_path / "a.usda", secret if layer == "first" else "prepend references = @./b.usda@</head>")
    package = Sdf.ZipFileWriter.CreateNew(str(tmp_path / "shot/a.usdz"))
    for name in ("a.usda", "b.usda", "inner.usda"):
        package.AddFile(str(tmp_path / name), name)
    package.Save()
    with pytest.raises(InputError, match="own folder"):
        opened(tmp_path / "shot/a.usdz")
    within = "b" if layer == "second" else "a"
    path = usda(tmp_path / "shot/c.usda", f"prepend references = @./a.usdz[{within}.usda]@</head>")
    with pytest.raises(InputError, match="own folder"):
        opened(path)


def test_a_package_of_several_layers_is_read(tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Sdf

    stage(tmp_path / "points.usda")
    usda(tmp_path / "a.usda", "prepend references = @./points.usda@</world/head>")
    package = Sdf.ZipFileWriter.CreateNew(str(tmp_path / "a.usdz"))
    for name in ("a.usda", "points.usda"):
        package.AddFile(str(tmp_path / name), name)
    package.Save()
    assert len(read_clip(tmp_path / "a.usdz")) == 3


def test_instances_within_instances_do_not_multiply_without_end(tmp_path, monkeypatch):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from tests.support.usd_stages import opened

    monkeypatch.setattr("rigs.usd.choice.MOST_PRIMS", 1000)  # else it takes its seconds
    levels = ['#usda 1.0\ndef Xform "L0" {\ndef Mesh "head" {\n}\n}\n']
    for level in range(1, 40):
        uses = "".join(f'def "{side}" (instanceable = true\n prepend references = </L{level - 1}>) {{\n}}\n' for side in "ab")
        levels.append(f'def Xform "L{level}" {{\n{uses}}}\n')
    (tmp_path / "a.usda").write_text("".join(levels))
    with pytest.raises(InputError, match=r"a.usda: more than 1,000 prims"):
        opened(tmp_path / "a.usda")
