"""glTF files: the checked document and its buffers."""

import codecs
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from riginv.errors import InputError, printable
from rigs.gltf.schema import Document, checked_document
from rigs.gltf.sources import DATA_URI, MAGIC, VERSION, beside, bytes_of, chunks, from_data_uri

UNIT_MM = 1000.0  # glTF is in metres
COMPRESSED = ("EXT_meshopt_compression", "KHR_meshopt_compression", "KHR_draco_mesh_compression")
SUPPORTED = ("KHR_mesh_quantization", "KHR_animation_pointer")
# Extensions that affect appearance or behaviour, not vertices.
HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "KHR_xmp", "VRM")


@dataclass(frozen=True)
class GltfFile:
    """An open glTF file; buffers are read on demand.

    Attributes:
        path: of the file.
        document: as from `checked_document`.
        chunk: binary chunk of a .glb, `(byte,)`; else None.
        notes: sentences about what was repaired or ignored.
    """

    path: Path
    document: Document
    chunk: np.ndarray | None
    notes: list[str] = field(default_factory=list)
    _buffers: dict[int, np.ndarray] = field(default_factory=dict)

    def note(self, sentence: str) -> None:
        """Add a sentence to `notes`, once."""
        text = printable(sentence)
        if text not in self.notes:
            self.notes.append(text)

    def item(self, kind: str, index: int, user: str) -> dict[str, Any]:
        """An item of one of the document's lists (`accessors`, `nodes`...).

        Args:
            user: what refers to it, for the message.

        Raises:
            InputError: there is no item of that index.
        """
        items = self.document.get(kind, [])
        if index >= len(items):
            raise InputError(f"{self.path}: {user} refers to {kind}[{index}], the file has {len(items)}: export it again")
        return items[index]

    def view(self, index: int, user: str) -> tuple[np.ndarray, int | None]:
        """Bytes `(byte,)` of a buffer view, and its stride, if any.

        Raises:
            InputError: it is compressed, or exceeds its buffer.
        """
        view = self.item("bufferViews", index, user)
        where = f"bufferViews[{index}]"
        compressed = [name for name in COMPRESSED if name in view.get("extensions", {})]
        data = self._buffer(view["buffer"], where, compressed)
        start, length = view.get("byteOffset", 0), view["byteLength"]
        if start + length > len(data):
            raise InputError(
                f"{self.path}: {where}, needed by {user}, ends at byte {start + length} of buffers[{view['buffer']}], "
                f"which has {len(data)}: the file is damaged; export it again"
            )
        return data[start : start + length], view.get("byteStride")

    def _buffer(self, index: int, user: str, compressed: list[str]) -> np.ndarray:
        """Bytes of a buffer; the fallback buffer of a compressed view may be missing from the file."""
        buffer = self.item("buffers", index, user)
        if index not in self._buffers:
            where, uri = f"buffers[{index}]", buffer.get("uri")
            if uri is None and compressed and (index != 0 or self.chunk is None):
                raise compression_error(self.path, compressed[0])
            if uri is None:
                data = self._binary_chunk(index)
            elif uri.startswith(DATA_URI):
                data = from_data_uri(self.path, where, uri)
            else:
                data = bytes_of(beside(self.path, where, uri), f"{where} of {self.path}")
            if len(data) < buffer["byteLength"]:
                raise InputError(
                    f"{self.path}: {where} holds {len(data)} bytes, expected {buffer['byteLength']}: "
                    f"the file is truncated; copy or export it again"
                )
            self._buffers[index] = data[: buffer["byteLength"]]
        return self._buffers[index]

    def _binary_chunk(self, index: int) -> np.ndarray:
        if index != 0 or self.chunk is None:
            raise InputError(
                f"{self.path}: buffers[{index}] names no file, and the file has no binary part for it: export it again"
            )
        return self.chunk


def open_gltf(path: str | Path) -> GltfFile:
    """Open a glTF file and check its document; .glb and .gltf are distinguished by content.

    Raises:
        InputError: the file is missing, truncated or not glTF 2.0, or requires an unsupported extension.
    """
    path = Path(path)
    data = bytes_of(path, "rig.file")
    chunk = None
    if data[:4].tobytes() == MAGIC:
        text, chunk = chunks(path, data)
    elif data[:64].tobytes().removeprefix(codecs.BOM_UTF8).lstrip().startswith(b"{"):
        text = data.tobytes()
    else:
        raise InputError(f"{path}: neither a .glb nor a .gltf: it starts with {data[:8].tobytes()!r}; expected glTF 2.0")
    try:
        raw = json.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: its JSON cannot be read ({error}): the file is damaged, or no glTF 2.0; export it again"
        ) from None
    document = checked_document(raw, path)
    if document["asset"]["version"].partition(".")[0] != str(VERSION):
        raise InputError(f"{path}: glTF version {document['asset']['version'][:20]!r}, expected 2.0: export it again as 2.0")
    for name in document.get("extensionsRequired", []):
        if name in COMPRESSED:
            raise compression_error(path, name)
        if name not in SUPPORTED and not name.startswith(HARMLESS):
            raise InputError(
                f"{path}: needs the extension {name[:60]}, which riginv does not read: export it again without that extension"
            )
    return GltfFile(path, document, chunk)


def compression_error(path: Path, extension: str) -> InputError:
    """The error for a compressed file; `gltf-transform cp` decompresses it (gltf-transform.dev/cli)."""
    return InputError(
        f"{path}: its meshes are compressed with {extension}; decompress it with "
        f"`npx @gltf-transform/cli cp {path.name} plain.glb` and give rig.file=plain.glb"
    )
