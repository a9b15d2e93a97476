"""Damaged and hostile avatars: one clear sentence that names the file and what in it; never a crash, never much memory."""

import json
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from riginv.errors import InputError
from rigs.gltf import GltfRig
from tests.config.test_bad_input import refused
from tests.support.avatars import AvatarWriter, cube

CUBE, FACES = cube()


def simple(path: Path) -> Path:
    """Accessors: 0 positions, 1 and 2 targets (2 sparse), 3 indices."""
    avatar = AvatarWriter()
    positions, first = avatar.accessor(CUBE), avatar.accessor(CUBE)
    second = avatar.sparse(CUBE * (np.arange(8) < 3)[:, None])
    avatar.node("head", mesh=avatar.mesh("face", [avatar.primitive(positions, FACES, [first, second])], ["a", "b"]))
    return avatar.write(path)


def parts(path: Path) -> tuple[dict, bytes]:
    data = path.read_bytes()
    length = struct.unpack("<I", data[12:16])[0]
    return json.loads(data[20 : 20 + length]), data[20 + length + 8 :]


def glb(path: Path, document: Any, blob: bytes) -> Path:
    text = (document if isinstance(document, str) else json.dumps(document)).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(blob)) + b"BIN\0" + blob
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)
    return path


def set_in(document: dict, place: str, value: Any) -> None:
    *way, last = [int(step) if step.isdigit() else step for step in place.split("/")]
    for step in way:
        document = document[step]
    document[last] = value


TWICE = [{"children": [1]}, {"children": [2]}, {"children": [1], "mesh": 0}]
CHANGES = [
    ("accessors/0/byteOffset", 4, "accessors[0], POSITION of mesh 'face', primitive 0, needs 100 bytes of bufferViews[0]"),
    ("accessors/1/count", 7, "moves 7 vertices, the primitive has 8"),
    ("accessors/0/count", 10**15, "has a count of 1000000000000000, expected 1 to"),
    ("accessors/0/count", 0, "has a count of 0"),
    ("accessors/0/count", "8", "accessors[0].count is '8', expected a whole number of at least 0"),
    ("accessors/0/count", -1, "accessors[0].count is -1"),
    ("accessors/0/count", 8.5, "accessors[0].count is 8.5"),
    ("accessors/0/type", "VEC2", "type 'VEC2', expected VEC3"),
    ("accessors/0/componentType", 5130, "componentType 5130"),
    ("accessors/0/bufferView", 99, "refers to bufferViews[99], the file has"),
    ("accessors/2/sparse/count", 9, "9 sparse values, expected 1 to 8"),
    ("accessors/2/sparse/indices/componentType", 5126, "sparse indices have component type 5126"),
    ("accessors/2/sparse/indices/bufferView", 0, "sparse indices must rise and stay below 8"),
    ("accessors/3/componentType", 5122, "expected unsigned integers"),
    ("accessors/3/count", 35, "35 corners, which make no whole triangles"),
    ("accessors/3/bufferView", 0, "uses vertex"),
    ("bufferViews/0/byteLength", 10**9, "ends at byte 1000000000 of buffers[0], which has"),
    ("bufferViews/0/byteStride", 4, "has byteStride 4, expected at least 12"),
    ("bufferViews/0/buffer", 3, "refers to buffers[3], the file has 1"),
    ("buffers/0/byteLength", 10**9, "expected 1000000000: the file is truncated"),
    ("buffers/0/uri", "https://example.com/a.bin", "expected a file in the avatar's own folder"),
    ("buffers/0/uri", "../a.bin", "expected a file in the avatar's own folder"),
    ("buffers/0/uri", "%2e%2e/a.bin", "expected a file in the avatar's own folder"),
    ("buffers/0/uri", "/etc/passwd", "expected a file in the avatar's own folder"),
    ("buffers/0/uri", "none.bin", "none.bin: no such file"),
    ("buffers/0/uri", "data:;base64,%%%", "cannot be decoded"),
    ("buffers/0/uri", "data:text/plain,hello", "cannot be decoded"),
    ("nodes/0/children", [0], "cycle"),
    ("nodes/0/children", [7], "refers to nodes[7]"),
    ("nodes", TWICE, "is a child of 'node_0' and of 'node_2'"),
    ("nodes/0/mesh", 4, "refers to meshes[4], the file has 1"),
    ("nodes/0/matrix", [1.0] * 12, "the matrix of node 'head' has 12 numbers, expected 16"),
    ("nodes/0/matrix", [1.0] * 16, "row 0 0 0 1"),
    ("nodes/0/rotation", [0, 0, 0, 0], "quaternion of length 0"),
    ("nodes/0/scale", [1, "x", 1], "nodes[0].scale[1] is 'x'"),
    ("nodes/0/translation", [1e999, 0, 0], "nodes[0].translation[0] is inf"),
    ("nodes", [], "no nodes"),
    ("nodes/0/scale", [1e200, 1, 1], "place vertices farther than 100 km away"),
    ("scenes/0/nodes", [5], "refers to nodes[5]"),
    ("scenes/0/nodes", [], "no mesh is left"),
    ("scene", 3, "refers to scenes[3]"),
    ("meshes", 5, "meshes is 5, expected a list"),
    ("meshes/0/primitives", [], "no morph targets in any"),
    ("meshes/0/primitives/0/attributes", {}, "has no POSITION"),
    ("meshes/0/primitives/0/mode", 1, "is made of LINES, expected triangles"),
    ("meshes/0/primitives/0/targets", [], "no morph targets in any of its meshes (head): nothing moves"),
    ("meshes/0/primitives/0/targets/0", {"POSITION": 44}, "refers to accessors[44]"),
    ("meshes/0/extras/targetNames", [1, 2], "is no list of texts"),
    ("asset/version", "1.0", "glTF version '1.0', expected 2.0"),
    ("asset", {}, "asset has no 'version'"),
    ("extensionsRequired", ["KHR_draco_mesh_compression"], "npx @gltf-transform/cli cp"),
    ("extensionsRequired", ["EXT_meshopt_compression"], "compressed with EXT_meshopt_compression"),
    ("extensionsRequired", ["ACME_voxels"], "needs the extension ACME_voxels"),
]


@pytest.mark.parametrize(("place", "value", "says"), CHANGES, ids=[f"{place}={str(value)[:20]}" for place, value, _ in CHANGES])
def test_a_damaged_document_is_explained(tmp_path, place, value, says):
    document, blob = parts(simple(tmp_path / "avatar.glb"))
    set_in(document, place, value)
    tracemalloc.start()
    with pytest.raises(InputError) as refusal:
        GltfRig(str(glb(tmp_path / "avatar.glb", document, blob)))
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    message = str(refusal.value)
    assert says in message and "avatar.glb" in message and "\n" not in message and len(message) < 500


def test_compressed_meshes_with_a_fallback_that_was_left_out_are_refused_too(tmp_path):
    document, blob = parts(simple(tmp_path / "a.glb"))
    document["bufferViews"][0] |= {"buffer": 1, "extensions": {"EXT_meshopt_compression": {"buffer": 0}}}
    document["buffers"].append({"byteLength": 96})
    with pytest.raises(
        InputError, match=r"compressed with EXT_meshopt_compression; decompress it with `npx .*cp a.glb plain.glb`"
    ):
        GltfRig(str(glb(tmp_path / "a.glb", document, blob)))
    document, blob = parts(simple(tmp_path / "a.glb"))
    document["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
    GltfRig(str(glb(tmp_path / "a.glb", document, blob)))  # the plain vertices are there besides
    del document["accessors"][0]["bufferView"]
    with pytest.raises(InputError, match="compressed with KHR_draco_mesh_compression"):
        GltfRig(str(glb(tmp_path / "a.glb", document, blob)))


def test_vertices_that_are_no_numbers_are_refused(tmp_path):
    document, blob = parts(simple(tmp_path / "a.glb"))
    blob = blob[:24] + struct.pack("<f", float("nan")) + blob[28:]
    with pytest.raises(
        InputError, match=r"accessors\[0\], POSITION of mesh 'face', primitive 0, holds NaN or infinity at element 2"
    ):
        GltfRig(str(glb(tmp_path / "a.glb", document, blob)))


def test_absurd_numbers_are_refused_before_anything_is_made_of_them(tmp_path):
    document, blob = parts(simple(tmp_path / "a.glb"))
    plain = {"componentType": 5126, "count": 80_000_000, "type": "VEC3"}  # zeros that no byte stands for
    document["accessors"][:2] = [plain, plain]
    document["accessors"][2] = {"componentType": 5126, "count": 80_000_000, "type": "VEC3"}
    many = [{"attributes": {"POSITION": 0}, "targets": [{"POSITION": 1}] * 2}]
    tracemalloc.start()
    for primitives in (many, many * 50_000):
        document["meshes"][0]["primitives"] = primitives
        with pytest.raises(InputError, match="more than can be meant: choose meshes with rig.include"):
            GltfRig(str(glb(tmp_path / "a.glb", document, blob)))
    assert tracemalloc.get_traced_memory()[1] < 200e6
    tracemalloc.stop()


def test_more_targets_than_could_be_meant_are_refused(tmp_path):
    document, blob = parts(simple(tmp_path / "a.glb"))
    document["meshes"][0]["primitives"][0]["targets"] = [{}] * 20_000
    with pytest.raises(InputError, match="20000 morph targets, expected the same number for all, at most"):
        GltfRig(str(glb(tmp_path / "a.glb", document, blob)))


def write_text(text: bytes) -> Callable[[bytes], bytes]:
    return lambda data: text


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (write_text(b""), "neither a .glb nor a .gltf"),
        (write_text(b"glTF"), "4 bytes, too short for a .glb"),
        (write_text(b"\x89PNG\r\n\x1a\n"), "neither a .glb nor a .gltf"),
        (write_text(b"{}"), "the document has no 'asset'"),
        (write_text(b'{"asset": '), "its JSON cannot be read"),
        (write_text(b'{"a":' * 200_000), "its JSON cannot be read"),
        (write_text(b'{"asset": {"version": "2.0"}, "scene": ' + b"9" * 6000 + b"}"), "its JSON cannot be read"),
        (write_text(b'{"asset": {"version": "2.0"}, "scene": 1e400}'), "scene is inf"),
        (lambda data: data[:-40], "by its header: the file is truncated"),
        (lambda data: data[:12] + struct.pack("<I", 2**31) + data[16:], "a part of 2147483648 bytes starts at byte 20"),
        (lambda data: data[:4] + struct.pack("<I", 1) + data[8:], "a .glb of version 1, expected 2"),
        (lambda data: data[:16] + b"JUNK" + data[20:], "without its JSON part"),
    ],
)
def test_a_damaged_container_is_explained(tmp_path, change, says):
    path = simple(tmp_path / "avatar.glb")
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(InputError) as refusal:
        GltfRig(str(path))
    assert says in str(refusal.value) and "avatar.glb" in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_link_does_not_lead_out_of_the_avatars_folder(tmp_path):
    document, blob = parts(simple(tmp_path / "a.glb"))
    (tmp_path / "secret.bin").write_bytes(blob)
    folder = tmp_path / "avatar"
    folder.mkdir()
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    document["buffers"][0]["uri"] = "link.bin"
    (folder / "a.gltf").write_text(json.dumps(document))
    with pytest.raises(InputError, match="own folder"):
        GltfRig(str(folder / "a.gltf"))


def test_no_damage_makes_it_crash(tmp_path):
    """Bytes and fields changed at random: it loads, or says what is wrong."""
    document, blob = parts(simple(tmp_path / "a.glb"))
    data, rng = (tmp_path / "a.glb").read_bytes(), np.random.default_rng(0)
    values = [-1, 0, 1, 3, 7, 2**31, 2**62, 1e300, None, True, "x", [], {}, [0], {"POSITION": 1}]
    loaded = 0
    for trial in range(400):
        path = tmp_path / "damaged.glb"
        if trial % 4 == 0:
            changed = np.frombuffer(data, np.uint8).copy()
            changed[rng.integers(0, len(data))] = rng.integers(0, 256)
            path.write_bytes(changed.tobytes()[: rng.integers(len(data) // 2, 8 * len(data))])
        else:
            damaged = json.loads(json.dumps(document))
            holder, key = places_in(damaged)[rng.integers(len(places_in(damaged)))]
            holder[key] = values[rng.integers(len(values))]
            glb(path, damaged, blob)
        try:
            GltfRig(str(path))
            loaded += 1
        except InputError as refusal:
            assert "\n" not in str(refusal)
    assert 20 < loaded < 380


def places_in(value: Any) -> list[tuple[Any, Any]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [place for key, inner in items for place in ((value, key), *places_in(inner))]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["rig.include=[Hea*]"], "rig.include names 'Hea*', no mesh is called so; its meshes are: head"),
        (["rig.exclude=[head]"], "no mesh is left for the rig"),
        (["rig.include=head"], "rig.include is 'head', expected a list"),
        (["rig.unit_mm=0"], "rig.unit_mm is 0"),
        (["rig.joints=true", "rig.joint_limit_deg=-5"], "rig.joint_limit_deg is -5"),
        (["rig.joints=true"], "names no joint that moves a vertex; its joints are: none"),
        (["rig.file=other.glb"], "error: other.glb: no such file, needed by rig.file"),
        (["rig.file=5"], "5: no such file"),
        (["rig.file=."], ".: no such file"),
    ],
)
def test_the_command_ends_in_one_sentence_and_leaves_nothing(run, tmp_path, arguments, says):
    simple(tmp_path / "avatar.glb")
    outcome = run("train", "rig=gltf", "rig.file=avatar.glb", "model=inverse", *arguments, small=False)
    refused(outcome, says)
    assert not outcome.folder.exists()
