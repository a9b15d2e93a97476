"""Processes that run steps beside each other, and end with the one that started them."""

import multiprocessing
import os
import shutil
import signal
import threading
import traceback
from collections.abc import Mapping
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

from riginv.errors import InputError, NonFiniteLossError
from riginv.launch.closed_output import filter_warnings
from riginv.reproduce.work import run_step

FULL_BYTES = 2_000_000  # a disk with less room than this is full


class Failure(NamedTuple):
    """Why a step failed: a sentence for the user, or a fault of ours with its traceback."""

    sentence: str | None
    trace: str


class Worker:
    """A process that runs one step at a time, in one thread each.

    Attributes:
        step: the name of the step that it is at, or None.
    """

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()
        self.step: str | None = None

    def start(self, name: str, job: Mapping[str, Any]) -> None:
        self.step = name
        self.connection.send(dict(job))

    def answer(self) -> Failure | None:
        """What came of the step: None, or why it failed."""
        self.step = None
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            self.process.join(5)
            return Failure(f"its process ended by itself (exit code {self.process.exitcode}): was there too little memory?", "")

    def end(self) -> None:
        self.process.kill()  # what it was at is begun anew, or gone on with from a checkpoint; nothing is left half-written
        self.process.join(5)
        self.connection.close()


def ready(workers: list[Worker], timeout_s: float) -> list[Worker]:
    """The workers whose step has ended."""
    by_connection: dict[Connection, Worker] = {worker.connection: worker for worker in workers if worker.step}
    return [by_connection[connection] for connection in wait(list(by_connection), timeout_s)]


def attempt(job: Mapping[str, Any]) -> Failure | None:
    """Run a step; None, or why it failed."""
    try:
        run_step(**job)
    except (InputError, NonFiniteLossError) as error:
        return Failure(str(error), traceback.format_exc())
    except OSError as error:
        return Failure(f"{error}; free or unlock what it names, then type the same command again", traceback.format_exc())
    except Exception:
        if shutil.disk_usage(job["folder"]).free < FULL_BYTES:  # libraries tell of a full disk in words of their own
            return Failure("the disk is full: free some of it, then type the same command again", traceback.format_exc())
        return Failure(None, traceback.format_exc())
    return None


def _serve(connection: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is for the process that started this one to stop it
    threading.Thread(target=_end_with_parent, daemon=True).start()
    filter_warnings()
    while True:
        try:
            job = connection.recv()
        except EOFError:
            return
        connection.send(attempt(job))


def _end_with_parent() -> None:
    wait([multiprocessing.parent_process().sentinel])
    os._exit(1)
