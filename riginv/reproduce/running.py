"""Running a graph of steps: what is kept is not run again, and a line tells of each step and of what is left."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from riginv.errors import InputError
from riginv.reproduce.steps import LOG, Graph
from riginv.reproduce.workers import Failure, Worker, attempt, ready

TICK_S = 0.5
MOST_JOBS = 4
TRUSTED_S = 60.0  # of what was expected stand for as much, before the first steps say otherwise


def jobs_here(jobs: int | None) -> int:
    """How many steps run beside each other: as asked, or one for each CPU core that this process may use, up to 4."""
    return jobs or min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, MOST_JOBS)


class Runner:
    """Runs a graph.

    Args:
        jobs: steps beside each other, each in a process with one thread, so that figures do not depend on it; 1: here.
    """

    def __init__(self, graph: Graph, jobs: int) -> None:
        self.graph, self.jobs = graph, jobs
        self.console = Console(stderr=True)
        self.left = [name for name in graph.steps if not graph.finished(name)]
        self.kept = len(graph.steps) - len(self.left)
        self.spent_s = self.expected_s = 0.0
        self.began: dict[str, float] = {}

    def run(self) -> None:
        """Run what is left.

        Raises:
            InputError: a step failed for a reason that the user can mend.
            RuntimeError: a step failed by a fault of ours.
        """
        if self.kept:
            self.console.print(f"{self.kept} of {len(self.graph.steps)} steps are kept from before", highlight=False)
        with self._bar() as self.bar:
            if self.jobs == 1:
                with one_thread():
                    while self.left:
                        self._ended(self._begin(self.left[0]), attempt(self._job(self.left[0])))
            elif self.left:
                with one_thread():  # the processes take over these variables
                    workers = [Worker() for _ in range(min(self.jobs, len(self.left)))]
                try:
                    self._share_out(workers)
                finally:
                    for worker in workers:
                        worker.end()

    def _share_out(self, workers: list[Worker]) -> None:
        waiting = list(self.left)
        while self.left:
            for worker in workers:
                name = next((name for name in waiting if self._can_start(name)), None)
                if worker.step is None and name is not None:
                    waiting.remove(name)
                    worker.start(self._begin(name), self._job(name))
            for worker in ready(workers, TICK_S):
                name = worker.step
                self._ended(name, worker.answer())

    def _can_start(self, name: str) -> bool:
        return not set(self.graph.steps[name].inputs.values()) & set(self.left)

    def _job(self, name: str) -> dict:
        step = self.graph.steps[name]
        given = {"config": dict(step.config), "places": dict(step.places), "inputs": self.graph.inputs(name)}
        return {"work": step.work, "folder": str(self.graph.path(name)), **given}

    def _begin(self, name: str) -> str:
        self.began[name] = time.monotonic()
        self.bar.update(self.bar.task_ids[0], description=", ".join(self.began))
        return name

    def _ended(self, name: str, failure: Failure | None) -> None:
        took = time.monotonic() - self.began.pop(name)
        if failure is not None and failure.sentence is None:
            raise RuntimeError(f"step {name} failed ({self.graph.path(name) / LOG}):\n{failure.trace}")
        if failure is not None:
            raise InputError(f"step {name}: {failure.sentence}")
        step = self.graph.steps[name]
        self.left.remove(name)
        self.spent_s, self.expected_s = self.spent_s + took, self.expected_s + step.expected_s
        done = len(self.graph.steps) - len(self.left)
        what = f": {step.about}" if step.about else ""
        left = f"  about {duration(self._still_s())} left" if self.left else ""
        line = f"[{done}/{len(self.graph.steps)}] {name}{what}, {duration(took)}{left}"
        self.bar.console.print(line, soft_wrap=True, highlight=False, markup=False)
        self.bar.update(self.bar.task_ids[0], completed=done)

    def _still_s(self) -> float:
        """What is left: as expected, corrected by how long the finished steps took against what was expected of them."""
        now = time.monotonic()
        ratio = (self.spent_s + TRUSTED_S) / (self.expected_s + TRUSTED_S)
        each = {name: self.graph.steps[name].expected_s * ratio for name in self.left}
        for name, began in self.began.items():
            each[name] = max(each[name] - (now - began), 0.0)
        return max(sum(each.values()) / self.jobs, max(each.values()))

    def _bar(self) -> Progress:
        columns = (BarColumn(24), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
        bar = Progress(*columns, console=self.console, transient=True, disable=not self.console.is_terminal)
        bar.add_task("", total=len(self.graph.steps), completed=self.kept)
        return bar


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for all arithmetic of this process and of those that it starts: sums then do not depend on the cores."""
    threads, names = torch.get_num_threads(), ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    torch.set_num_threads(1)
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)


def duration(seconds: float) -> str:
    """Seconds in words: `48 s`, `12 min`, `31 h`, `12 days`."""
    for limit, unit, one in ((90, "s", 1), (5400, "min", 60), (48 * 3600, "h", 3600)):
        if seconds < limit:
            return f"{seconds / one:.0f} {unit}"
    return f"{seconds / 86400:.0f} days"
