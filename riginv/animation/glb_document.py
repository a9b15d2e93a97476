"""Writer of GLB files: a JSON document and a binary buffer (glTF 2.0)."""

import json
import struct
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from riginv.runs.files import atomic_write

COMPONENTS = {np.dtype(np.float32): 5126, np.dtype(np.uint32): 5125, np.dtype(np.uint16): 5123}
SHAPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
VERTICES, INDICES = 34962, 34963  # targets of buffer views
MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942


class GlbDocument:
    """Collects nodes, meshes and an animation, and writes them.

    Args:
        name: of the animation.

    Attributes:
        content: the JSON document so far.
    """

    def __init__(self, name: str) -> None:
        self.content: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": f"riginv {version('riginv')}"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
            "animations": [{"name": name, "samplers": [], "channels": []}],
        }
        self.binary = bytearray()

    def add(self, kind: str, entry: dict[str, Any]) -> int:
        """Add an entry to one of the document's lists; returns its index."""
        self.content.setdefault(kind, []).append(entry)
        return len(self.content[kind]) - 1

    def node(self, entry: dict[str, Any], in_scene: bool = False) -> int:
        """Add a node, and with `in_scene` as a root of the scene."""
        number = self.add("nodes", entry)
        if in_scene:
            self.content["scenes"][0]["nodes"].append(number)
        return number

    def array(self, values: np.ndarray, kind: str = "", bounds: bool = False, vertices: bool = False) -> int:
        """Add an accessor for rows of numbers `(row, number)`."""
        kind = kind or SHAPES[values.shape[1]]
        entry = {
            "bufferView": self._view(values, VERTICES if vertices else None),
            "componentType": COMPONENTS[values.dtype],
            "count": len(values),
            "type": kind,
        }
        if bounds:
            entry |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        return self.add("accessors", entry)

    def indices(self, values: np.ndarray) -> int:
        """Add an accessor for the corners of faces `(corner,)`."""
        view = self._view(values.astype(np.uint32), INDICES)
        entry = {"bufferView": view, "componentType": 5125, "count": len(values), "type": "SCALAR"}
        return self.add("accessors", entry)

    def sparse(self, count: int, rows: np.ndarray, values: np.ndarray) -> int:
        """Add an accessor of `count` vectors, all 0 but those in `rows`."""
        values = values.astype(np.float32).reshape(-1, 3)
        entry: dict[str, Any] = {"componentType": 5126, "count": count, "type": "VEC3"}
        bounded = values if len(rows) == count else np.concatenate([values, np.zeros((1, 3), np.float32)])
        entry |= {"min": bounded.min(axis=0).tolist(), "max": bounded.max(axis=0).tolist()}
        if len(rows):
            entry["sparse"] = {
                "count": len(rows),
                "indices": {"bufferView": self._view(rows.astype(np.uint32)), "componentType": 5125},
                "values": {"bufferView": self._view(values)},
            }
        return self.add("accessors", entry)

    def times(self, seconds: np.ndarray) -> int:
        """Add the times of the frames."""
        return self.array(seconds.astype(np.float32)[:, None], bounds=True)

    def channel(self, node: int, path: str, times: int, values: np.ndarray) -> None:
        """Animate a node's `translation`, `rotation` or `weights`, linear between frames."""
        animation = self.content["animations"][0]
        output = self.array(np.ascontiguousarray(values, np.float32))
        animation["samplers"].append({"input": times, "output": output, "interpolation": "LINEAR"})
        sampler = len(animation["samplers"]) - 1
        animation["channels"].append({"sampler": sampler, "target": {"node": node, "path": path}})

    def save(self, path: Path) -> None:
        """Write the file atomically."""
        self.content["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.content, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        with atomic_write(path) as beside, beside.open("wb") as file:
            file.write(struct.pack("<3I", MAGIC, VERSION, 12 + 8 + len(text) + 8 + len(self.binary)))
            file.write(struct.pack("<2I", len(text), JSON_CHUNK) + text)
            file.write(struct.pack("<2I", len(self.binary), BINARY_CHUNK))
            file.write(self.binary)

    def _view(self, values: np.ndarray, target: int | None = None) -> int:
        data = np.ascontiguousarray(values).tobytes()
        entry = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        self.binary += data + b"\0" * (-len(data) % 4)
        return self.add("bufferViews", entry | ({"target": target} if target else {}))
