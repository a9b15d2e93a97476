"""Runs inside Blender's Python: evaluates a .blend for another process (docs/worker-protocol.md).

    PYTHON worker.py     or     blender --background --factory-startup --python worker.py

`serve` is independent of Blender: with another scene that has the same three methods it serves Maya or Houdini. The files of
this folder need only the standard library, NumPy and bpy.
"""

import ctypes
import json
import math
import os
import struct
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

GREETING = b"riginv-worker 1\n"
COMMANDS = ("load", "describe", "evaluate")


class RefusedError(Exception):
    """A request cannot be met; the message is for the user.

    Args:
        meshes: name, vertices and frames of each mesh, where it is not clear which is meant; one frame: it never moves.
    """

    are_scans = False

    def __init__(self, message: str, meshes: Sequence[tuple[str, int, int]] = ()) -> None:
        super().__init__(message)
        self.meshes = meshes


class RefusedScansError(RefusedError):
    """A file cannot be read as a clip of one mesh, and can as a clip of scans."""

    are_scans = True


class Channel:
    """Messages over the original standard input and output; prints go to standard error."""

    def __init__(self) -> None:
        self.incoming, self.outgoing = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(2, 1)
        self.outgoing.write(GREETING)
        self.outgoing.flush()

    def receive(self) -> tuple[dict[str, Any] | None, dict[str, np.ndarray]]:
        """A header and its arrays by name; None and nothing at the end of the input."""
        length = self.incoming.read(4)
        if len(length) < 4:
            return None, {}
        header = json.loads(self.incoming.read(struct.unpack("<I", length)[0]))
        arrays = {}
        for field in header.pop("arrays", []):
            count = math.prod(field["shape"]) * np.dtype(field["dtype"]).itemsize
            arrays[field["name"]] = np.frombuffer(self.incoming.read(count), field["dtype"]).reshape(field["shape"])
        return header, arrays

    def send(self, header: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        """Send a header and arrays by name."""
        packed = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        fields = [{"name": name, "dtype": array.dtype.str, "shape": array.shape} for name, array in packed.items()]
        encoded = json.dumps({**header, "arrays": fields}).encode()
        self.outgoing.write(struct.pack("<I", len(encoded)) + encoded)
        for array in packed.values():
            self.outgoing.write(array.tobytes())
        self.outgoing.flush()


def serve(scene: Any) -> None:
    """Answer requests until a `quit` request or the end of the input."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, 9)  # PR_SET_PDEATHSIG, SIGKILL: during an evaluation the end of the parent is not noticed
    channel = Channel()
    while True:
        header, arrays = channel.receive()
        if header is None or header["command"] == "quit":
            os._exit(0)  # nothing to save, and Blender takes its time to clean up
        command = header.pop("command")
        try:
            if command not in COMMANDS:
                raise RefusedError(f"there is no command '{command}'")
            answer = getattr(scene, command)(**header, **arrays)
        except RefusedError as error:
            answer = {"error": str(error), "are_scans": error.are_scans, "meshes": list(error.meshes)}, {}
        channel.send(*answer)


if __name__ == "__main__":
    sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))  # Blender does not add it
    sys.modules["worker"] = sys.modules["__main__"]  # so that the scene's RefusedError is ours
    cores = os.sched_getaffinity(0) if sys.platform == "linux" else None
    if cores:  # workers share the cores between them: Blender starts as many threads as it sees cores when it is loaded
        os.sched_setaffinity(0, {min(cores)})
    from scene import BlenderScene

    if cores:
        os.sched_setaffinity(0, cores)
    serve(BlenderScene())
