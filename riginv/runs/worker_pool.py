"""A pool of worker processes, which are replaced when they crash, hang or leak."""

import contextlib
import os
import queue
import threading
import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from riginv.runs.worker_process import KILL_TIMEOUT_S, Message, WorkerLostError, WorkerProcess, WorkerRefusedError

ATTEMPTS = 3  # workers that a request may lose
POLL_S = 1.0
GROWTH_MB = 2000.0


@dataclass(eq=False)
class Request:
    """One request to a worker.

    Attributes:
        header, arrays: of the message.
        losses: workers that it has lost so far.
    """

    header: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    losses: int = 0

    @property
    def is_measured(self) -> bool:
        """Whether the growth of a worker's memory is measured after it."""
        return True

    def check(self, answer: Message) -> None:
        """Raises WorkerLostError where an answer does not match the request."""

    def split(self) -> "Sequence[Request]":
        """The requests that replace it after a worker was lost."""
        return [self]


Outcome = Message | BaseException


class Job:
    """Requests of one caller and their outcomes; iteration ends when none is pending.

    A request whose worker was lost is repeated; its outcome is a WorkerLostError only after `attempts` of these.
    """

    def __init__(self, crew: "_Crew", attempts: int) -> None:
        self._crew, self._attempts = crew, attempts
        self.outcomes: queue.Queue[tuple[Request, Outcome]] = queue.Queue()
        self.pending = 0
        self.cancelled = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.cancelled = True

    def submit(self, *requests: Request) -> None:
        self.pending += len(requests)
        self._crew.put([(self, request) for request in requests])

    def __iter__(self) -> Iterator[tuple[Request, Outcome]]:
        while self.pending:
            yield self.next_outcome()

    def next_outcome(self) -> tuple[Request, Outcome]:
        while True:
            request, outcome = self._crew.next_outcome(self)
            self.pending -= 1
            if not isinstance(outcome, WorkerLostError):
                return request, outcome
            request.losses += 1
            if request.losses >= self._attempts:
                return request, outcome
            repeated = request.split()
            for one in repeated:
                one.losses = request.losses
            self.submit(*repeated)


class ProcessPool:
    """Workers that have all loaded the same, started when needed and replaced when lost.

    Args:
        command: command line of a worker.
        load: header of the request that a worker gets first.
        workers: greatest number of workers.
        timeout_s: time limit of an answer; None: unlimited.
        environment: additional variables for the workers.
        growth_mb: growth of a worker's memory at which it is replaced; None: unlimited.
    """

    def __init__(
        self,
        command: Sequence[str],
        load: Mapping[str, Any],
        workers: int = 1,
        timeout_s: float | None = 120.0,
        environment: Mapping[str, str] | None = None,
        growth_mb: float | None = GROWTH_MB,
    ) -> None:
        self._settings = (tuple(command), dict(load), workers, timeout_s, dict(environment or {}), growth_mb)
        self._crew: _Crew | None = None
        self._starting = threading.Lock()

    def __deepcopy__(self, memo: dict) -> Self:
        return type(self)(*self._settings)

    def __reduce__(self) -> tuple:
        return type(self), self._settings

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Start all workers now instead of with the first requests."""
        self._own_crew().start_all()

    def job(self, attempts: int = ATTEMPTS) -> Job:
        """A new job without requests."""
        return Job(self._own_crew(), attempts)

    def process_ids(self) -> list[int]:
        """Ids of the running workers."""
        return self._crew.process_ids() if self._crew else []

    def close(self) -> None:
        """End all workers; the next request starts new ones."""
        with self._starting:
            if self._crew:
                self._crew.close()
                self._crew.join()
            self._crew = None

    def _own_crew(self) -> "_Crew":
        """The workers of this process: a fork must not use the pipes of its parent."""
        with self._starting:
            if self._crew is None or self._crew.owner != os.getpid():
                self._crew = _Crew(*self._settings)
                weakref.finalize(self, self._crew.close)  # also at the end of Python
            return self._crew


class _Crew:
    """Threads that each manage one worker process. It has no reference to the pool, so that the pool can be collected."""

    def __init__(
        self,
        command: tuple[str, ...],
        load: dict[str, Any],
        workers: int,
        timeout_s: float | None,
        environment: dict[str, str],
        growth_mb: float | None,
    ) -> None:
        self.owner = os.getpid()
        self._command, self._load, self._most = command, load, workers
        self._timeout_s, self._environment, self._growth_mb = timeout_s, environment, growth_mb
        self._waiting: queue.Queue[tuple[Job, Request] | None] = queue.Queue()
        self._threads: list[threading.Thread] = []
        self._running: set[WorkerProcess] = set()
        self._closed = False

    def put(self, requests: list[tuple[Job, Request]]) -> None:
        wanted = min(self._most, self._waiting.qsize() + len(requests))
        for request in requests:
            self._waiting.put(request)
        while len(self._threads) < wanted:
            self._add_thread(starts_at_once=False)

    def start_all(self) -> None:
        while len(self._threads) < self._most:
            self._add_thread(starts_at_once=True)

    def next_outcome(self, job: Job) -> tuple[Request, Outcome]:
        while True:
            with contextlib.suppress(queue.Empty):
                return job.outcomes.get(timeout=POLL_S)
            if self._closed:
                raise RuntimeError("the pool was closed while requests were pending")

    def process_ids(self) -> list[int]:
        return [process.pid for process in list(self._running)]

    def close(self) -> None:
        if self._closed or self.owner != os.getpid():
            return
        self._closed = True
        for _ in self._threads:
            self._waiting.put(None)
        for process in list(self._running):
            process.kill()

    def join(self) -> None:
        """Wait until the workers have ended."""
        for thread in self._threads if self.owner == os.getpid() else ():
            thread.join(KILL_TIMEOUT_S)

    def _add_thread(self, starts_at_once: bool) -> None:
        # Linux can end a worker with the thread that started it, so this thread runs as long as the pool exists.
        thread = threading.Thread(target=self._manage_worker, args=(starts_at_once,), daemon=True)
        self._threads.append(thread)
        thread.start()

    def _manage_worker(self, starts_at_once: bool) -> None:
        process: WorkerProcess | None = None
        if starts_at_once:
            with contextlib.suppress(Exception):  # the first request fails in the same way, and reports it
                process = self._start()
        while (waiting := self._waiting.get()) is not None and not self._closed:
            job, request = waiting
            if job.cancelled:
                continue
            outcome: Outcome
            try:
                process = process or self._start()
                outcome = process.request(request.header, request.arrays, self._timeout_s)
                request.check(outcome)
                if self._growth_mb is not None and request.is_measured and process.growth_mb() > self._growth_mb:
                    self._end(process)
                    process = None
            except WorkerRefusedError as error:
                outcome = error
            except BaseException as error:
                outcome = error
                self._end(process)
                process = None
            job.outcomes.put((request, outcome))
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
