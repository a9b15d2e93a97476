"""One worker process at the other end of a pipe (docs/worker-protocol.md)."""

import contextlib
import json
import math
import os
import signal
import struct
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import psutil

GREETING = b"riginv-worker 1\n"
LONGEST_HEADER = 1 << 26  # bytes; more is not a header
PATIENCE_S = 10.0  # for the system to end a process that was killed
LOOK_S = 0.25  # between two looks at its memory, at least: each takes milliseconds

Message = tuple[dict[str, Any], dict[str, np.ndarray]]


class WorkerLostError(Exception):
    """A worker died, hung, or spoke nonsense; the message says which."""


class WorkerRefusedError(Exception):
    """A worker says why it cannot do what it was asked; it is well and waits for the next request."""


class WorkerProcess:
    """A running worker.

    Args:
        command: what to run.
        environment: variables on top of those of this process.
    """

    def __init__(self, command: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        self._errors = tempfile.TemporaryFile()
        self._folder = tempfile.TemporaryDirectory(prefix="riginv-worker-", ignore_cleanup_errors=True)
        self._timed_out = False
        self._greeted = False
        self._memory_at_first: int | None = None
        self._looked = -math.inf
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env={**os.environ, "TMPDIR": self._folder.name, **(environment or {})},  # what it leaves there goes with it
            start_new_session=True,  # a group of its own, so that whatever it starts ends with it
        )

    @property
    def pid(self) -> int:
        return self._process.pid

    def request(self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray], timeout_s: float) -> Message:
        """Send a request and wait for its answer.

        Raises:
            WorkerLostError: there will be none, or none came in time; the process is gone.
            WorkerRefusedError: the answer is an error.
        """
        watchdog = threading.Timer(timeout_s, self._give_up)
        watchdog.daemon = True
        watchdog.start()
        try:
            self._send(header, arrays)
            answer, found = self._receive()
        except (OSError, EOFError, ValueError, KeyError, TypeError) as error:
            watchdog.cancel()
            self.end()
            raise WorkerLostError(self._why(error, timeout_s)) from None
        finally:
            watchdog.cancel()
        if "error" in answer:
            raise WorkerRefusedError(answer["error"])
        return answer, found

    def growth_mb(self) -> float:
        """By how much it and all that it has started hold more memory than when this was first asked; 0 between two looks."""
        if time.monotonic() - self._looked < LOOK_S:
            return 0.0
        self._looked = time.monotonic()
        try:
            worker = psutil.Process(self.pid)
            memory = sum(one.memory_info().rss for one in (worker, *worker.children(recursive=True)))
        except psutil.Error:  # whoever ended meanwhile is not counted, and the next request tells of the worker
            return 0.0
        self._memory_at_first = memory if self._memory_at_first is None else self._memory_at_first
        return (memory - self._memory_at_first) / 1e6

    def kill(self) -> None:
        """Kill it and all that it started; whoever waits for its answer is told."""
        if hasattr(os, "killpg"):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        else:
            self._process.kill()

    def end(self) -> None:
        """Kill it, and clear away what is left of it."""
        self.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(PATIENCE_S)
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                pipe.close()
        self._folder.cleanup()

    def _give_up(self) -> None:
        self._timed_out = True
        self.kill()

    def _send(self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        packed = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        fields = [{"name": name, "dtype": array.dtype.str, "shape": array.shape} for name, array in packed.items()]
        encoded = json.dumps({**header, "arrays": fields}).encode()
        self._process.stdin.write(struct.pack("<I", len(encoded)) + encoded)
        for array in packed.values():
            self._process.stdin.write(array.tobytes())
        self._process.stdin.flush()

    def _receive(self) -> Message:
        if not self._greeted:
            self._skip_to_greeting()
        (length,) = struct.unpack("<I", self._read(4))
        if length > LONGEST_HEADER:
            raise ValueError("its answer is not one")
        header = json.loads(self._read(length))
        arrays = {}
        for field in header.pop("arrays"):
            dtype = np.dtype(field["dtype"])
            data = self._read(math.prod(field["shape"]) * dtype.itemsize)
            arrays[field["name"]] = np.frombuffer(data, dtype).reshape(field["shape"])
        return header, arrays

    def _skip_to_greeting(self) -> None:
        """Programs such as Blender print a banner before the worker runs."""
        seen = b""
        while not seen.endswith(GREETING):
            seen = (seen + self._read(1))[-len(GREETING) :]
        self._greeted = True

    def _read(self, count: int) -> bytes:
        data = self._process.stdout.read(count)
        if len(data) < count:
            raise EOFError
        return data

    def _why(self, error: Exception, timeout_s: float) -> str:
        if self._timed_out:
            return f"it gave no answer in {timeout_s:g} s"
        if not isinstance(error, OSError | EOFError):
            return f"it gave an answer that cannot be read: {error}"
        code = self._process.returncode
        how = "it ended" if code is None else f"it was ended by signal {-code}" if code < 0 else f"it ended with code {code}"
        self._errors.seek(0)
        lines = [line for line in self._errors.read().decode(errors="replace").splitlines() if line.strip()]
        return f"{how}: {lines[-1].strip()}" if lines else how
