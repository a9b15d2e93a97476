"""DNA files read and written back, byte for byte."""

import dataclasses
import struct

import numpy as np
import pytest

from rigs.dna.format import DnaFile, Layer, read_dna, write_dna
from rigs.dna.format.container import dna_bytes, parse_dna
from rigs.dna.format.cursor import Cursor, Writer
from rigs.dna.format.layers import Behavior, Definition, Descriptor, Geometry
from rigs.dna.format.ragged import Ragged, read_ragged, write_ragged
from tests.rigs.dna.files import SHARED, draft, everything, shared, two_levels

SHARED_FILES = sorted(path.relative_to(SHARED) for path in SHARED.glob("dna/*/*.dna")) or ["dna/fixtures/v2.8.dna"]


def same(one: object, other: object) -> bool:
    """Whether two layers are equal, arrays included."""
    if dataclasses.is_dataclass(one):
        return type(one) is type(other) and all(
            same(getattr(one, field.name), getattr(other, field.name)) for field in dataclasses.fields(one)
        )
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    return one == other


@pytest.mark.parametrize("operations", [False, True])
def test_what_is_written_is_read_back(operations, tmp_path):
    file = everything(operations=operations)
    write_dna(tmp_path / "a.dna", file)
    found = read_dna(tmp_path / "a.dna")
    assert found.version == 8 and found.unused_bytes == 0
    assert [(layer.name, layer.version) for layer in found.layers] == [(layer.name, layer.version) for layer in file.layers]
    assert found.layers[-1].content == b"kept as it is"
    assert all(same(one.content, other.content) for one, other in zip(found.layers, file.layers))
    assert dna_bytes(found) == (tmp_path / "a.dna").read_bytes()


def test_version_2_1_has_sections_at_offsets_and_a_footer():
    file = dataclasses.replace(two_levels(draft().file()), version=1)
    data = dna_bytes(file)
    assert data.startswith(b"DNA\0\2\0\1") and data.endswith(b"AND")
    offsets = struct.unpack(">8I", data[7:39])
    assert offsets[0] == 39 and offsets[2] == offsets[3] and list(offsets) == sorted(offsets)
    found = parse_dna(data, "x")
    assert dna_bytes(found) == data
    for kind in (Descriptor, Definition, Behavior, Geometry):
        assert same(found.need(kind), file.need(kind))


def test_layers_are_known_by_name_and_version_together():
    plain = draft().file()
    newer = Layer("geom", (1, 2), b"from the future")
    data = dna_bytes(dataclasses.replace(plain, layers=(newer, *plain.layers)))
    found = parse_dna(data, "x")
    assert found.layers[0].content == b"from the future" and len(found.need(Geometry).meshes) == 3
    assert dna_bytes(found) == data


def test_bytes_between_layers_are_counted():
    data = dna_bytes(draft().file())
    assert parse_dna(data + b"tail", "x").unused_bytes == 4


def test_every_bit_of_a_number_is_kept(tmp_path):
    random = np.random.default_rng(0)
    bits = random.integers(0, 2**32, 3000, dtype=np.uint64).astype(np.uint32)
    bits[:2] = 0x7F800001, 0xFFC00123  # NaNs, one of which signals
    file = everything()
    behavior = file.need(Behavior)
    odd = dataclasses.replace(behavior.joints.groups[0], values=bits.view(np.float32))
    joints = dataclasses.replace(behavior.joints, groups=(odd,))
    layers = tuple(
        Layer.of(dataclasses.replace(behavior, joints=joints)) if isinstance(layer.content, Behavior) else layer
        for layer in file.layers
    )
    data = dna_bytes(dataclasses.replace(file, layers=layers))
    assert bits.astype(">u4").tobytes() in data
    assert dna_bytes(parse_dna(data, "x")) == data


def test_names_that_are_no_utf_8_are_kept():
    file = draft().file()
    data = dna_bytes(file).replace("Zoë".encode(), b"Z\xff\xfe\xfd")
    assert dna_bytes(parse_dna(data, "x")) == data


def test_lists_of_lists_of_any_lengths():
    random = np.random.default_rng(0)
    sizes = random.integers(0, 5, 50)
    weights = Ragged(random.random(sizes.sum()).astype(np.float32), sizes)
    joints = Ragged(random.integers(0, 9, sizes[::-1].sum()).astype(np.uint16), sizes[::-1])
    dtypes = [np.dtype(">f4"), np.dtype(">u2")]
    writer = Writer()
    write_ragged(writer, [weights, joints], dtypes)
    expected = struct.pack(">I", 50)
    at = {0: 0, 1: 0}
    for row in range(50):
        for number, (column, dtype) in enumerate(((weights, ">f4"), (joints, ">u2"))):
            size = int(column.sizes[row])
            expected += struct.pack(">I", size) + column.values[at[number] : at[number] + size].astype(dtype).tobytes()
            at[number] += size
    assert bytes(writer.data) == expected
    found = read_ragged(Cursor("x", expected, 0, len(expected), "y"), dtypes)
    assert np.array_equal(found[0].values, weights.values) and np.array_equal(found[0].sizes, weights.sizes)
    assert np.array_equal(found[1].values, joints.values) and np.array_equal(found[1].sizes, joints.sizes)
    assert found[0].owners.tolist() == np.repeat(np.arange(50), sizes).tolist()


@pytest.mark.parametrize("name", SHARED_FILES, ids=str)
def test_files_of_others_are_read_and_written_byte_for_byte(name):
    path = shared(str(name))
    file = read_dna(path)
    assert isinstance(file, DnaFile) and file.unused_bytes == 0
    assert dna_bytes(file) == path.read_bytes()


def test_layers_that_a_file_does_not_say_it_has_are_read():
    path = shared("dna/fixtures/v2.2-from-2.3.dna")
    file = read_dna(path)
    assert file.version == 2 and [layer.name for layer in file.layers] == ["desc", "defn", "bhvr", "geom", "mlbh"]
    future = read_dna(shared("dna/fixtures/v2.65535-newer.dna"))
    assert all(isinstance(layer.content, bytes) for layer in future.layers)
