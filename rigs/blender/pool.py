"""A pool of worker processes: none that dies or hangs costs more than time."""

import contextlib
import os
import queue
import threading
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rigs.blender.process import Message, WorkerLostError, WorkerProcess, WorkerRefusedError

CHUNK = 16  # poses that a worker gets at a time, at most
ATTEMPTS = 3  # after so many lost workers in a row the pose is the cause
POLL_S = 1.0
GROWTH_MB = 2000.0


class PoseLostError(RuntimeError):
    """A pose, or loading, cost several workers in a row; the message says which, and how the last one ended.

    Attributes:
        row: of the pose; None: no pose was asked for.
    """

    def __init__(self, message: str, row: int | None = None) -> None:
        super().__init__(message)
        self.row = row


@dataclass
class _Job:
    """What one call waits for."""

    outcomes: queue.Queue = field(default_factory=queue.Queue)
    cancelled: bool = False


@dataclass
class _Task:
    """One request to a worker, for the poses `rows` of its job."""

    job: _Job
    rows: range
    header: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]
    losses: int = 0


class WorkerPool:
    """Workers that all have loaded the same, started when they are needed, and replaced when they are lost.

    Args:
        command: what runs a worker.
        load: the header of the request that readies it.
        workers: how many at most.
        timeout_s: for one answer; a worker that takes longer is taken for hung.
        environment: variables for the workers.
        growth_mb: a worker that holds so much more memory than after its first poses is replaced; None: never.
    """

    def __init__(
        self,
        command: Sequence[str],
        load: Mapping[str, Any],
        workers: int = 1,
        timeout_s: float = 120.0,
        environment: Mapping[str, str] | None = None,
        growth_mb: float | None = GROWTH_MB,
    ) -> None:
        self._settings = (tuple(command), dict(load), workers, timeout_s, dict(environment or {}), growth_mb)
        self._crew: _Crew | None = None
        self._starting = threading.Lock()

    def __deepcopy__(self, memo: dict) -> "WorkerPool":
        return WorkerPool(*self._settings)

    def __reduce__(self) -> tuple:
        return WorkerPool, self._settings

    def __enter__(self) -> "WorkerPool":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def describe(self) -> Message:
        """What a worker says of what it has loaded.

        Raises:
            WorkerRefusedError: it cannot load it.
            PoseLostError: loading cost several workers.
        """
        (answer,) = self._run([(range(0), {"command": "describe"}, {})]).values()
        return answer

    def evaluate(self, names: Sequence[str], controls: np.ndarray) -> np.ndarray:
        """The meshes of poses, in their order.

        Args:
            names: of the columns of `controls`; a worker holds all other controls at neutral.
            controls: `(pose, control)` float32.

        Returns:
            `(pose, vertex, 3)` float32, mm.

        Raises:
            WorkerRefusedError: a pose cannot be evaluated.
            PoseLostError: a pose cost several workers in a row.
        """
        size = min(CHUNK, -(-len(controls) // self._settings[2]))
        header = {"command": "evaluate", "names": list(names)}
        starts = range(0, len(controls), max(size, 1)) or [0]
        rows = [range(start, min(start + size, len(controls))) for start in starts]
        answers = self._run([(part, header, {"controls": controls[part.start : part.stop]}) for part in rows])
        return np.concatenate([answers[start][1]["vertices"] for start in sorted(answers)])

    def process_ids(self) -> list[int]:
        """Of the workers that run now."""
        return self._crew.process_ids() if self._crew else []

    def close(self) -> None:
        """End all workers; the next request starts new ones."""
        with self._starting:
            if self._crew:
                self._crew.close()
            self._crew = None

    def _run(self, requests: list[tuple[range, Mapping[str, Any], Mapping[str, np.ndarray]]]) -> dict[int, Message]:
        """The answers to requests, by the first row of each."""
        job = _Job()
        crew = self._own_crew()
        crew.put([_Task(job, *request) for request in requests])
        answers, waiting = {}, len(requests)
        try:
            while waiting:
                task, outcome = crew.next_outcome(job)
                waiting -= 1
                if isinstance(outcome, WorkerLostError):
                    again = _again(task, outcome)
                    waiting += len(again)
                    crew.put(again)
                elif isinstance(outcome, BaseException):
                    raise outcome
                else:
                    answers[task.rows.start] = outcome
        finally:
            job.cancelled = True
        return answers

    def _own_crew(self) -> "_Crew":
        """The workers of this process: a fork must not speak into the pipes of its parent."""
        with self._starting:
            if self._crew is None or self._crew.owner != os.getpid():
                self._crew = _Crew(*self._settings)
                weakref.finalize(self, self._crew.close)  # also when Python ends
            return self._crew


def _again(task: _Task, loss: WorkerLostError) -> list[_Task]:
    """The tasks that stand in for one whose worker was lost: each pose by itself, so that one bad pose costs no other."""
    losses = task.losses + 1
    if losses >= ATTEMPTS:
        row = task.rows.start if len(task.rows) else None
        what = "describing the rig" if row is None else f"pose {row}"
        raise PoseLostError(f"{what} cost {ATTEMPTS} workers in a row; of the last one: {loss}", row)
    if len(task.rows) <= 1:
        return [_Task(task.job, task.rows, task.header, task.arrays, losses)]
    controls = task.arrays["controls"]
    return [
        _Task(task.job, range(row, row + 1), task.header, {"controls": controls[place : place + 1]}, losses)
        for place, row in enumerate(task.rows)
    ]


class _Crew:
    """The threads that each look after one worker process. It does not know the pool, so that the pool can be collected."""

    def __init__(
        self, command: tuple, load: dict, workers: int, timeout_s: float, environment: dict, growth_mb: float | None
    ) -> None:
        self.owner = os.getpid()
        self._command, self._load, self._most = command, load, workers
        self._timeout_s, self._environment, self._growth_mb = timeout_s, environment, growth_mb
        self._tasks: queue.Queue[_Task | None] = queue.Queue()
        self._threads: list[threading.Thread] = []
        self._running: set[WorkerProcess] = set()
        self._closed = False

    def put(self, tasks: list[_Task]) -> None:
        wanted = min(self._most, self._tasks.qsize() + len(tasks))
        for task in tasks:
            self._tasks.put(task)
        while len(self._threads) < wanted:
            # Linux ends a worker with the thread that started it, so this thread lives as long as the pool.
            thread = threading.Thread(target=self._look_after_one, daemon=True)
            self._threads.append(thread)
            thread.start()

    def next_outcome(self, job: _Job) -> tuple[_Task, Any]:
        while True:
            with contextlib.suppress(queue.Empty):
                return job.outcomes.get(timeout=POLL_S)
            if self._closed:
                raise RuntimeError("the pool was closed while poses were evaluated")

    def process_ids(self) -> list[int]:
        return [process.pid for process in list(self._running)]

    def close(self) -> None:
        if self._closed or self.owner != os.getpid():
            return
        self._closed = True
        for _ in self._threads:
            self._tasks.put(None)
        for process in list(self._running):
            process.kill()

    def _look_after_one(self) -> None:
        process: WorkerProcess | None = None
        while (task := self._tasks.get()) is not None and not self._closed:
            if task.job.cancelled:
                continue
            try:
                process = process or self._start()
                outcome = process.request(task.header, task.arrays, self._timeout_s)
                _check(outcome, task)
                if self._growth_mb is not None and task.rows and process.growth_mb() > self._growth_mb:
                    self._end(process)
                    process = None
            except WorkerRefusedError as error:
                outcome = error
            except BaseException as error:
                outcome = error
                self._end(process)
                process = None
            task.job.outcomes.put((task, outcome))
        self._end(process)

    def _start(self) -> WorkerProcess:
        process = WorkerProcess(self._command, self._environment)
        self._running.add(process)
        try:
            if self._closed:
                raise WorkerLostError("the pool was closed")
            process.request({"command": "load", **self._load}, {}, self._timeout_s)
        except BaseException:
            self._end(process)
            raise
        return process

    def _end(self, process: WorkerProcess | None) -> None:
        if process is not None:
            process.end()
            self._running.discard(process)


def _check(answer: Message, task: _Task) -> None:
    """Raises WorkerLostError where an answer is not one to the task."""
    vertices = answer[1].get("vertices")
    if task.header["command"] == "evaluate" and (vertices is None or vertices.ndim != 3 or len(vertices) != len(task.rows)):
        raise WorkerLostError(f"it gave {'no meshes' if vertices is None else vertices.shape} for {len(task.rows)} poses")
