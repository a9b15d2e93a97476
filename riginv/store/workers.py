"""Chunks made by processes of this machine: one that dies is replaced, and ends with its parent."""

import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence

from riginv.config.building import ClassSpec
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.sampling.meshes import MeshSampler

ATTEMPTS = 3  # after so many lost workers in a row the chunk is the cause


class ChunkWorkers:
    """Processes that make chunks; they start, and build their rig, at once.

    Args:
        out: the store's path.
        rig, sampler: what builds them in each process.
        jobs: how many.
    """

    def __init__(self, out: str, rig: ClassSpec[RigBackend], sampler: ClassSpec[MeshSampler], jobs: int) -> None:
        self.task = json.dumps({"place": out, "rig": rig.config, "sampler": sampler.config})
        self.closed = False
        self.processes = [self._start() for _ in range(jobs)]

    def __enter__(self) -> "ChunkWorkers":
        return self

    def __exit__(self, *_: object) -> None:
        self.closed = True
        for process in self.processes:
            process.kill()
            process.wait()

    def make(self, chunks: Sequence[int]) -> Iterator[int]:
        """Make chunks, and give their numbers as they are complete.

        Raises:
            InputError: a chunk cannot be made or written; the others' workers are stopped.
        """
        waiting: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        for chunk in [*chunks, *(None for _ in self.processes)]:
            waiting.put(chunk)
        outcomes: queue.SimpleQueue[int | Exception] = queue.SimpleQueue()
        for number in range(len(self.processes)):
            threading.Thread(target=self._keep_busy, args=(number, waiting, outcomes), daemon=True).start()
        for _ in chunks:
            outcome = outcomes.get()
            if isinstance(outcome, Exception):
                raise outcome
            yield outcome

    def _keep_busy(self, number: int, waiting: queue.SimpleQueue, outcomes: queue.SimpleQueue) -> None:
        while (chunk := waiting.get()) is not None:
            try:
                outcomes.put(self._made(number, chunk))
            except Exception as error:
                outcomes.put(error)
                return

    def _made(self, number: int, chunk: int) -> int:
        for _ in range(ATTEMPTS):
            process = self.processes[number]
            try:
                process.stdin.write(f"{chunk}\n")
                process.stdin.flush()
                answer = process.stdout.readline()
            except OSError:
                answer = ""
            if not answer:
                code = process.wait()
                if self.closed:
                    break
                self.processes[number] = self._start()
                continue
            said = json.loads(answer)
            if "error" in said:
                raise InputError(said["error"])
            if "fault" in said:
                raise RuntimeError(f"a worker failed at chunk {chunk}:\n{said['fault']}")
            if said["tired"]:
                process.kill()
                process.wait()
                self.processes[number] = self._start()
            return said["done"]
        raise InputError(
            f"chunk {chunk} cost {ATTEMPTS} worker processes in a row, the last of which ended with code {code}: it may want "
            f"more memory than there is; try fewer jobs, or jobs=1 to see it happen"
        )

    def _start(self) -> subprocess.Popen:
        """A worker that has been told its task."""
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([path or os.getcwd() for path in sys.path]),
            "OMP_NUM_THREADS": "1",
        }
        process = subprocess.Popen(
            [sys.executable, "-m", "riginv.store.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            env=environment,
        )
        process.stdin.write(self.task + "\n")
        process.stdin.flush()
        return process
