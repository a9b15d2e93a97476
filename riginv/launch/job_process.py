"""Runs a job of a sweep in a subprocess, isolated from the other jobs.

The subprocess exits when its parent does, even if the parent is killed.
"""

import os
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from riginv.launch.sweep_record import FINISHED, TRACEBACK, JobRecord, read_record, record_file

THREADS = "OMP_NUM_THREADS MKL_NUM_THREADS OPENBLAS_NUM_THREADS BLIS_NUM_THREADS VECLIB_MAXIMUM_THREADS NUMEXPR_NUM_THREADS"
PARENT_PID = "RIGINV_PARENT_PID"  # process id of the launcher, in the environment of a job


@dataclass(frozen=True)
class Job:
    """The description of a job, for any process or machine: plain values, and folders that all machines share.

    Attributes:
        module: the command, as in `python -m MODULE`.
        arguments: its arguments.
        sweep: the sweep's folder.
        number: its index in the sweep, from 0.
        name: of its folder.
        swept: its swept overrides, as KEY=VALUE.
        directory: where the command was typed.
        can_resume: whether the command takes `resume=true`.
    """

    module: str
    arguments: list[str]
    sweep: Path
    number: int
    name: str
    swept: list[str]
    directory: Path
    can_resume: bool

    def record(self) -> JobRecord:
        return read_record(self.sweep, self.number, self.name, self.swept)


def run_in_subprocess(job: Job, threads: int | None = None) -> None:
    """Run a job to its end in a subprocess; its record holds the outcome.

    Args:
        job: skipped if finished; resumed if it was started before.
        threads: number of threads that it may use; None: no limit.
    """
    record = job.record()
    if record.state == FINISHED:
        return
    resume = ["resume=true"] if job.can_resume and record.starts else []
    record.started(job.sweep)
    began = time.perf_counter()
    log_file = record_file(job.sweep, job.name).with_suffix(".log")
    with log_file.open("ab") as log:
        start = log.tell()
        with subprocess.Popen(
            [sys.executable, "-m", job.module, *job.arguments, *resume],
            cwd=job.directory if job.directory.is_dir() else None,
            env={
                **os.environ,
                PARENT_PID: str(os.getpid()),
                **(dict.fromkeys(THREADS.split(), str(threads)) if threads else {}),
            },
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
        ) as process:
            code = process.wait()
    output = log_file.read_bytes()[start:].decode("utf-8", errors="replace")
    record.ended(job.sweep, time.perf_counter() - began, None if code == 0 else _failure(output, code))


def exit_with_parent() -> None:
    """In the process of a job: exit as soon as its launcher has ended."""
    parent = os.environ.pop(PARENT_PID, None)
    if parent is not None:
        exit_with_process(int(parent))


def _failure(output: str, code: int) -> str:
    """The last line of a failed process's output, or the signal that killed it."""
    if code < 0:
        return f"its process was killed by signal {-code}{', possibly out of memory' if code == -9 else ''}"
    *before, last = output.rstrip().splitlines() or [f"its process ended with code {code}"]
    if last.startswith("error: "):
        return last.removeprefix("error: ")
    traceback = max((number for number, line in enumerate(before) if line == TRACEBACK), default=len(before))
    return "\n".join([*before[traceback:], last])


POLL_SECONDS = 0.5


def exit_with_process(parent: int) -> None:
    """Exit as soon as the parent, of that process id, has ended."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(POLL_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
