"""Progress bar of a sweep whose jobs run in subprocesses, with a line for each finished job."""

import threading
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

from riginv.launch.job_process import Job
from riginv.launch.sweep_record import FAILED, RUNNING, JobRecord
from riginv.runs.console import Bar, duration

POLL_SECONDS = 0.5


class SweepProgress(Bar):
    """A progress bar that reads the jobs' records; without a terminal only a line for each finished job is printed.

    Args:
        jobs: the jobs of the sweep that have not finished.
    """

    def __init__(self, jobs: Sequence[Job]) -> None:
        self.jobs, self.total, self.failed = list(jobs), len(jobs), 0
        super().__init__(BarColumn(24), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
        self.task = self.bar.add_task("", total=self.total)
        self.over = threading.Event()
        self.watching = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        super().__enter__()
        self.watching.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.over.set()
        self.watching.join()
        super().__exit__(kind, error, trace)

    def _watch(self) -> None:
        while not self.over.wait(POLL_SECONDS):
            self._update()
        self._update()

    def _update(self) -> None:
        records = [(job, job.record()) for job in self.jobs]
        self.jobs = [job for job, record in records if not record.has_ended]
        for _, record in records:
            if record.has_ended:
                self.failed += record.state == FAILED
                self._print_end(record)
        running = "; ".join(record.label for _, record in records if record.state == RUNNING)
        shown = f"{f'{self.failed} failed  ' if self.failed else ''}{f'running: {running}' if running else ''}"
        self.bar.update(self.task, completed=self.total - len(self.jobs), description=escape(shown))

    def _print_end(self, record: JobRecord) -> None:
        how = f"{record.state} in {duration(record.seconds)}"
        if record.state == FAILED:
            how = f"[bold red]{how}:[/] {escape(record.why)}"
        self.bar.console.print(f"{escape(record.label)}  {how}", soft_wrap=True, highlight=False)
