"""A worker process that answers requests over pipes (docs/worker-protocol.md), and the encoding of messages."""

import contextlib
import json
import math
import os
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from typing import IO, Any

import numpy as np
import psutil

GREETING = b"riginv-worker 1\n"
LONGEST_HEADER = 1 << 26  # bytes
KILL_TIMEOUT_S = 10.0
LOOK_S = 0.25  # least time between two measurements of memory, which take milliseconds

Message = tuple[dict[str, Any], dict[str, np.ndarray]]


class WorkerLostError(Exception):
    """A worker crashed, timed out, or sent an invalid answer, as the message states."""


class WorkerRefusedError(Exception):
    """A worker cannot meet a request, and is ready for the next one; the message is for the user.

    Attributes:
        are_scans: whether the file can be read as a clip of scans.
        meshes: name, vertices and frames of each mesh of the file, where it is not clear which is meant.
    """

    def __init__(self, message: str, are_scans: bool = False, meshes: Sequence[tuple[str, int, int]] = ()) -> None:
        super().__init__(message)
        self.are_scans, self.meshes = are_scans, tuple((str(name), int(size), int(frames)) for name, size, frames in meshes)


def write_message(stream: IO[bytes], header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Write a header and arrays by name."""
    packed = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    fields = [{"name": name, "dtype": array.dtype.str, "shape": array.shape} for name, array in packed.items()]
    encoded = json.dumps({**header, "arrays": fields}).encode()
    stream.write(struct.pack("<I", len(encoded)) + encoded)
    for array in packed.values():
        stream.write(array.tobytes())
    stream.flush()


def read_message(stream: IO[bytes]) -> Message:
    """Read a header and arrays by name.

    Raises:
        EOFError: the stream ends.
        ValueError, KeyError, TypeError: it is no message.
    """
    (length,) = struct.unpack("<I", _read(stream, 4))
    if length > LONGEST_HEADER:
        raise ValueError("its answer is not one")
    header = json.loads(_read(stream, length))
    arrays = {}
    for field in header.pop("arrays"):
        dtype = np.dtype(field["dtype"])
        data = _read(stream, math.prod(field["shape"]) * dtype.itemsize)
        arrays[field["name"]] = np.frombuffer(data, dtype).reshape(field["shape"])
    return header, arrays


def _read(stream: IO[bytes], count: int) -> bytes:
    data = stream.read(count)
    if len(data) < count:
        raise EOFError
    return data


def python_worker(module: str) -> tuple[list[str], dict[str, str]]:
    """Command line and environment of a worker that is a module of Python (`riginv.runs.worker`), in a single thread."""
    environment = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    environment["PYTHONPATH"] = os.pathsep.join([path or os.getcwd() for path in sys.path])
    return [sys.executable, "-m", module], environment | {"TMPDIR": tempfile.gettempdir()}


class WorkerProcess:
    """A running worker.

    Args:
        command: what to run.
        environment: additional variables; unless TMPDIR is among them, the worker has a temporary folder of its own.
    """

    def __init__(self, command: Sequence[str], environment: Mapping[str, str]) -> None:
        self._last_error = ""
        self._folder = None
        if "TMPDIR" not in environment:
            self._folder = tempfile.TemporaryDirectory(prefix="riginv-worker-", ignore_cleanup_errors=True)
            environment = {**environment, "TMPDIR": self._folder.name}
        self._timed_out = False
        self._greeted = False
        self._has_ended = False
        self._memory_at_first: int | None = None
        self._looked = -math.inf
        with contextlib.ExitStack() as stack:
            self._errors = stack.enter_context(tempfile.TemporaryFile())
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                env={**os.environ, **environment},
                start_new_session=True,  # its own process group, so that its children end with it
            )
            stack.pop_all()
        assert self._process.stdin and self._process.stdout
        self._input, self._output = self._process.stdin, self._process.stdout

    @property
    def pid(self) -> int:
        return self._process.pid

    def request(self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray], timeout_s: float | None) -> Message:
        """Send a request and wait for its answer.

        Raises:
            WorkerLostError: no answer, or not in time; the process has ended.
            WorkerRefusedError: the answer is an error for the user.
            RuntimeError: the answer is the traceback of a bug.
        """
        watchdog = threading.Timer(timeout_s or 0.0, self._time_out)
        watchdog.daemon = True
        if timeout_s is not None:
            watchdog.start()
        try:
            write_message(self._input, header, arrays)
            if not self._greeted:
                self._skip_to_greeting()
            answer, found = read_message(self._output)
        except (OSError, EOFError, ValueError, KeyError, TypeError) as error:
            watchdog.cancel()
            self.end()
            raise WorkerLostError(self._reason(error, timeout_s)) from None
        finally:
            watchdog.cancel()
        if "error" in answer:
            raise WorkerRefusedError(answer["error"], answer.get("are_scans") is True, answer.get("meshes") or ())
        if "fault" in answer:
            raise RuntimeError(f"a worker failed at {dict(header)}:\n{answer['fault']}")
        return answer, found

    def growth_mb(self) -> float:
        """Growth of the memory of it and its children since the first call; 0 between two measurements."""
        if time.monotonic() - self._looked < LOOK_S:
            return 0.0
        self._looked = time.monotonic()
        try:
            worker = psutil.Process(self.pid)
            memory = sum(one.memory_info().rss for one in (worker, *worker.children(recursive=True)))
        except psutil.Error:  # one of them has ended; the next request shows whether the worker has
            return 0.0
        self._memory_at_first = memory if self._memory_at_first is None else self._memory_at_first
        return (memory - self._memory_at_first) / 1e6

    def kill(self) -> None:
        """Kill it and its children; a pending request raises WorkerLostError."""
        if self._has_ended:  # its id may be that of another process by now
            return
        if hasattr(os, "killpg"):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        else:
            self._process.kill()

    def end(self) -> None:
        """Kill it, and release its pipes and its temporary folder."""
        self.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(KILL_TIMEOUT_S)
            self._has_ended = True
        if not self._errors.closed:
            self._errors.seek(0)
            lines = [line for line in self._errors.read().decode(errors="replace").splitlines() if line.strip()]
            self._last_error = lines[-1].strip() if lines else ""
        for file in (self._input, self._output, self._errors):
            with contextlib.suppress(OSError):
                file.close()
        if self._folder is not None:
            self._folder.cleanup()

    def _time_out(self) -> None:
        self._timed_out = True
        self.kill()

    def _skip_to_greeting(self) -> None:
        """Skip output before the worker runs, such as Blender's banner."""
        seen = b""
        while not seen.endswith(GREETING):
            seen = (seen + _read(self._output, 1))[-len(GREETING) :]
        self._greeted = True

    def _reason(self, error: Exception, timeout_s: float | None) -> str:
        if self._timed_out:
            return f"it gave no answer in {timeout_s:g} s"
        if not isinstance(error, OSError | EOFError):
            return f"it gave an answer that cannot be read: {error}"
        code = self._process.returncode
        how = "it ended" if code is None else f"it was ended by signal {-code}" if code < 0 else f"it ended with code {code}"
        return f"{how}: {self._last_error}" if self._last_error else how
