"""Running a graph of steps: finished steps are skipped, and a line is printed for each step, with the remaining time."""

import time
from dataclasses import dataclass

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from riginv.errors import InputError
from riginv.reproduce.steps import LOG, Graph, Workspace
from riginv.reproduce.worker import Failure, attempt, failure_in, request_header
from riginv.runs.console import duration
from riginv.runs.threads import allowed_cores, single_threaded
from riginv.runs.worker_pool import Job, ProcessPool, Request
from riginv.runs.worker_process import WorkerLostError, python_worker

MOST_JOBS = 4
TRUSTED_S = 60.0  # weight of the expected durations against those of the first steps


def jobs_here(jobs: int | None) -> int:
    """Number of parallel steps; None: one per CPU core that this process may use, up to 4."""
    return jobs or min(len(allowed_cores()), MOST_JOBS)


@dataclass(eq=False)
class StepRequest(Request):
    """The request to run a step."""

    name: str = ""


class Runner:
    """Runs a graph.

    Args:
        jobs: number of parallel steps, each in a process with one thread, so that figures do not depend on it; 1: this process.
    """

    def __init__(self, graph: Graph, jobs: int) -> None:
        self.graph, self.jobs = graph, jobs
        self.console = Console(stderr=True)
        self.remaining = [name for name in graph.steps if not graph.is_finished(name)]
        self.kept = len(graph.steps) - len(self.remaining)
        self.spent_s = self.expected_s = 0.0
        self.began: dict[str, float] = {}

    def run(self) -> None:
        """Run the remaining steps.

        Raises:
            InputError: a step failed for a reason that the user can remove.
            RuntimeError: a step failed by an error of riginv.
        """
        if self.kept:
            self.console.print(f"{self.kept} of {len(self.graph.steps)} steps are kept from before", highlight=False)
        with self._bar() as self.bar:
            if self.jobs == 1:
                with single_threaded():
                    while self.remaining:
                        name = self.remaining[0]
                        self._begin(name)
                        self._end(name, attempt(self.graph.steps[name].task, self._workspace(name)))
            elif self.remaining:
                self._run_in_workers()

    def _run_in_workers(self) -> None:
        command, environment = python_worker("riginv.reproduce.worker")
        workers = min(self.jobs, len(self.remaining))
        with ProcessPool(command, {}, workers, timeout_s=None, environment=environment, growth_mb=None) as pool:
            pool.start()
            with pool.job(attempts=1) as job:
                waiting = list(self.remaining)
                while self.remaining:
                    self._submit(job, waiting, workers)
                    request, outcome = job.next_outcome()
                    assert isinstance(request, StepRequest)
                    if isinstance(outcome, WorkerLostError):
                        reason = f"its process ended by itself ({outcome}): was there too little memory?"
                        self._end(request.name, Failure(reason, ""))
                    elif isinstance(outcome, BaseException):
                        raise outcome
                    else:
                        self._end(request.name, failure_in(outcome[0]))

    def _submit(self, job: Job, waiting: list[str], workers: int) -> None:
        """Submit steps whose inputs are finished, one for each idle worker."""
        for name in list(waiting):
            if job.pending < workers and not set(self.graph.steps[name].inputs.values()) & set(self.remaining):
                waiting.remove(name)
                self._begin(name)
                job.submit(StepRequest(request_header(self.graph.steps[name].task, self._workspace(name)), name=name))

    def _workspace(self, name: str) -> Workspace:
        return Workspace(self.graph.path(name), self.graph.inputs(name), self.graph.steps[name].context)

    def _begin(self, name: str) -> None:
        self.began[name] = time.monotonic()
        self.bar.update(self.bar.task_ids[0], description=", ".join(self.began))

    def _end(self, name: str, failure: Failure | None) -> None:
        took = time.monotonic() - self.began.pop(name)
        if failure is not None and failure.sentence is None:
            raise RuntimeError(f"step {name} failed ({self.graph.path(name) / LOG}):\n{failure.trace}")
        if failure is not None:
            raise InputError(f"step {name}: {failure.sentence}")
        step = self.graph.steps[name]
        self.remaining.remove(name)
        self.spent_s, self.expected_s = self.spent_s + took, self.expected_s + step.expected_s
        done = len(self.graph.steps) - len(self.remaining)
        about = f": {step.about}" if step.about else ""
        left = f"  about {duration(self._remaining_s())} left" if self.remaining else ""
        line = f"[{done}/{len(self.graph.steps)}] {name}{about}, {duration(took)}{left}"
        self.bar.console.print(line, soft_wrap=True, highlight=False, markup=False)
        self.bar.update(self.bar.task_ids[0], completed=done)

    def _remaining_s(self) -> float:
        """Remaining time: expected durations, scaled by those of the finished steps."""
        now = time.monotonic()
        ratio = (self.spent_s + TRUSTED_S) / (self.expected_s + TRUSTED_S)
        each = {name: self.graph.steps[name].expected_s * ratio for name in self.remaining}
        for name, began in self.began.items():
            each[name] = max(each[name] - (now - began), 0.0)
        return max(sum(each.values()) / self.jobs, max(each.values()))

    def _bar(self) -> Progress:
        columns = (BarColumn(24), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
        bar = Progress(*columns, console=self.console, transient=True, disable=not self.console.is_terminal)
        bar.add_task("", total=len(self.graph.steps), completed=self.kept)
        return bar
