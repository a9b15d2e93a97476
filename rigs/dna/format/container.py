"""DNA files: an index and layers (from version 2.2 on), or sections at eight offsets (version 2.1)."""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from riginv.errors import InputError, in_short
from riginv.runs.files import atomic_write, check_regular
from rigs.dna.format.codecs import Record
from rigs.dna.format.cursor import Cursor, Writer
from rigs.dna.format.later_layers import (
    Conventions,
    JointRepresentations,
    MachineLearning,
    MachineLearningOperations,
    RadialBasis,
    RadialBasisOutputs,
    TwistsAndSwings,
)
from rigs.dna.format.layers import AnimatedMaps, Behavior, Channels, Controls, Definition, Descriptor, Geometry, Joints

MAGIC, FOOTER = b"DNA", b"AND"
GENERATION = 2
UNLAYERED = 1  # the version of files without an index
HEADER = struct.Struct(">3sHH")
ENTRY = struct.Struct(">4sHHII")
OFFSETS = struct.Struct(">8I")
LARGEST = 1 << 31  # bytes; the largest production heads have a third of it
KINDS: dict[tuple[str, int, int], type] = {
    ("desc", 1, 1): Descriptor,
    ("defn", 1, 1): Definition,
    ("bhvr", 1, 1): Behavior,
    ("geom", 1, 1): Geometry,
    ("mlbh", 1, 0): MachineLearning,
    ("rbfb", 1, 0): RadialBasis,
    ("rbfe", 1, 0): RadialBasisOutputs,
    ("jbmd", 1, 0): JointRepresentations,
    ("twsw", 1, 0): TwistsAndSwings,
    ("mlbe", 1, 0): MachineLearningOperations,
    ("dsce", 1, 0): Conventions,
}
SECTIONS = (Descriptor, Definition, Behavior, Controls, Joints, Channels, AnimatedMaps, Geometry)  # of the eight offsets
CODECS = {kind: Record(kind) for kind in {*KINDS.values(), *SECTIONS}}
Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Layer:
    """One layer.

    Attributes:
        name: four letters.
        version: major and minor.
        content: the dataclass of `KINDS`; bytes where this name and version are not known together.
    """

    name: str
    version: tuple[int, int]
    content: Any

    @classmethod
    def of(cls, content: Any) -> "Layer":
        """The layer that holds a dataclass of `KINDS`."""
        name, major, minor = next(key for key, kind in KINDS.items() if kind is type(content))
        return cls(name, (major, minor), content)


@dataclass(frozen=True)
class DnaFile:
    """A DNA file.

    Attributes:
        path: for messages.
        version: 1 for 2.1, 8 for 2.8.
        layers: in the order of the file.
        unused_bytes: how many bytes belonged to no layer.
    """

    path: str
    version: int
    layers: tuple[Layer, ...]
    unused_bytes: int = 0

    def find(self, kind: type[Kind]) -> Kind | None:
        """The layer of a kind, or None.

        Raises:
            InputError: there are two.
        """
        found = [layer.content for layer in self.layers if isinstance(layer.content, kind)]
        if len(found) > 1:
            raise InputError(f"{self.path}: two layers {_name_of(kind)}, expected one: export the file again")
        return found[0] if found else None

    def need(self, kind: type[Kind]) -> Kind:
        """The layer of a kind.

        Raises:
            InputError: there is none, or there are two.
        """
        found = self.find(kind)
        if found is None:
            there = ", ".join(f"{layer.name} {layer.version[0]}.{layer.version[1]}" for layer in self.layers) or "none"
            raise InputError(
                f"{self.path}: no layer {_name_of(kind)}, which a rig needs; its layers are: {there[:200]}: export it as one "
                f"of the versions 2.1 to 2.8, complete"
            )
        return found


def _name_of(kind: type) -> str:
    return next(f"'{name} {major}.{minor}'" for (name, major, minor), known in KINDS.items() if known is kind)


def read_dna(path: str | Path) -> DnaFile:
    """Read a DNA file of any version from 2.1 on.

    Raises:
        InputError: it cannot be read, or is damaged or truncated; the message has the position.
    """
    path = Path(path)
    check_regular(path)
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: {path.stat().st_size:,} bytes, expected at most {LARGEST:,}: this is no DNA file")
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        missing = isinstance(error, FileNotFoundError)
        raise InputError(f"{path}: {'no such file' if missing else f'cannot be read: {in_short(error)}'}") from None
    return parse_dna(data, str(path))


def parse_dna(data: bytes, where: str) -> DnaFile:
    """As `read_dna`, from bytes; `where` names them in messages."""
    if len(data) < HEADER.size or not data.startswith(MAGIC):
        raise InputError(f"{where}: starts with {data[:8]!r}, expected 'DNA': this is no DNA file, or it is truncated")
    _, generation, version = HEADER.unpack_from(data)
    if generation != GENERATION or version < UNLAYERED:
        raise InputError(
            f"{where}: DNA version {generation}.{version}, expected 2.1 or later of generation 2: export it as one of them"
        )
    return _parse_sections(data, where) if version == UNLAYERED else _parse_layers(data, where, version)


def _parse_layers(data: bytes, where: str, version: int) -> DnaFile:
    index = Cursor(where, data, HEADER.size, len(data), "the index of its layers")
    entries = [ENTRY.unpack_from(data, index.take(ENTRY.size)) for _ in range(index.count(ENTRY.size))]
    expected, unused = index.position, 0
    for name, _, _, offset, size in sorted(entries, key=lambda entry: entry[3:]):
        if offset < expected or offset + size > len(data):
            raise index.damaged(f"layer {name!r} is at bytes {offset:,} to {offset + size:,}, the file has {len(data):,}")
        unused += offset - expected
        expected = offset + size
    layers = []
    for name, major, minor, offset, size in entries:
        name = name.decode("latin-1")
        kind = KINDS.get((name, major, minor))
        if kind is None:
            layers.append(Layer(name, (major, minor), data[offset : offset + size]))
            continue
        cursor = Cursor(where, data, offset, offset + size, f"layer '{name}'")
        layers.append(Layer(name, (major, minor), CODECS[kind].read(cursor)))
        if cursor.remaining:
            raise cursor.damaged(f"{cursor.remaining:,} bytes are left at its end, byte {cursor.position:,}")
    return DnaFile(where, version, tuple(layers), unused + len(data) - expected)


def _parse_sections(data: bytes, where: str) -> DnaFile:
    cursor = Cursor(where, data, HEADER.size, len(data), "the offsets of its sections", absolute_sizes=True)
    offsets = OFFSETS.unpack_from(data, cursor.take(OFFSETS.size))
    found: dict[type, Any] = {}
    for kind, offset in zip(SECTIONS, offsets):
        cursor.part = f"section '{kind.__name__.lower()}'"
        if offset != cursor.position:
            raise cursor.damaged(f"it is at byte {offset:,}, the one before it ends at byte {cursor.position:,}")
        if kind is not Behavior:  # its offset is that of its first section
            found[kind] = CODECS[kind].read(cursor)
    cursor.part = "the end"
    start = cursor.take(len(FOOTER))
    if data[start : start + len(FOOTER)] != FOOTER:
        raise cursor.damaged(f"{data[start : start + 3]!r} stands there, expected {FOOTER!r}")
    behavior = Behavior(found[Controls], found[Joints], found[Channels], found[AnimatedMaps])
    contents = (found[Descriptor], found[Definition], behavior, found[Geometry])
    return DnaFile(where, UNLAYERED, tuple(Layer.of(content) for content in contents), cursor.remaining)


def dna_bytes(file: DnaFile) -> bytes:
    """Bytes of a file: equal to those it was read from, except bytes of no layer.

    Raises:
        InputError: version 2.1 cannot hold its layers.
    """
    if file.version == UNLAYERED:
        return _section_bytes(file)
    writer = Writer()
    writer.data += HEADER.pack(MAGIC, GENERATION, file.version) + struct.pack(">I", len(file.layers))
    index = writer.position
    writer.data += bytes(ENTRY.size * len(file.layers))
    for number, layer in enumerate(file.layers):
        begin = writer.position
        if isinstance(layer.content, bytes):
            writer.data += layer.content
        else:
            CODECS[type(layer.content)].write(writer, layer.content)
        entry = (layer.name.encode("latin-1"), *layer.version, begin, writer.position - begin)
        ENTRY.pack_into(writer.data, index + ENTRY.size * number, *entry)
    return bytes(writer.data)


def _section_bytes(file: DnaFile) -> bytes:
    if len(file.layers) != 4:
        raise InputError(f"{file.path}: version 2.1 holds four layers, found {len(file.layers)}: write it as 2.2 or later")
    writer = Writer(absolute_sizes=True)
    writer.data += HEADER.pack(MAGIC, GENERATION, UNLAYERED) + bytes(OFFSETS.size)
    behavior = file.need(Behavior)
    sections = [file.need(Descriptor), file.need(Definition), None, behavior.controls, behavior.joints]
    sections += [behavior.channels, behavior.maps, file.need(Geometry)]
    offsets = []
    for section in sections:
        offsets.append(writer.position)
        if section is not None:
            CODECS[type(section)].write(writer, section)
    OFFSETS.pack_into(writer.data, HEADER.size, *offsets)
    return bytes(writer.data + FOOTER)


def write_dna(path: str | Path, file: DnaFile) -> None:
    """Write a file atomically."""
    data = dna_bytes(file)
    with atomic_write(Path(path)) as partial:
        partial.write_bytes(data)
