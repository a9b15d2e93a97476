"""Launches a command once for each device, monitors the processes, and on failure ends all and prints the first error.

Each process has its own session, so that Ctrl-C reaches only the launcher, which forwards it to rank 0. Only rank 0 prints. If
the launcher is killed, all ranks exit (`riginv.launch.rank_process`).
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from lightning.fabric.plugins.environments.lightning import find_free_network_port

from riginv.errors import InputError
from riginv.launch.rank_process import LAUNCHER_PID, REPORT, read_report
from riginv.launch.terminal import INTERRUPTED

COMMAND = "riginv.train"
POLL_SECONDS = 0.1
GRACE_SECONDS = 5.0  # for further reports, once a rank has failed
STOP_SECONDS = 20.0  # for rank 0 to exit after Ctrl-C
SECONDARY_ERRORS = ("closed by peer", "reset by peer", "Broken pipe", "NCCL")  # errors of ranks caused by the death of another


def run_in_processes(count: int, folder: Path) -> None:
    """Run this command once for each of `count` devices, in the run's folder, and wait for all of them.

    Ctrl-C or SIGTERM end them as they end a run of one process.

    Raises:
        InputError: one of them failed and has a sentence for it, or was killed.
    """
    with tempfile.TemporaryDirectory(prefix="riginv_") as reports:
        processes = _start(count, folder, Path(reports))
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            died = _wait(processes)
        except KeyboardInterrupt:
            _interrupt(processes[0])
            raise SystemExit(INTERRUPTED) from None  # rank 0 has said it
        finally:
            _kill(processes)
            signal.signal(signal.SIGTERM, before)
        if died:
            _report_failure(died, count, Path(reports))


def _start(count: int, folder: Path, reports: Path) -> list[subprocess.Popen]:
    quoted = str(folder).replace("\\", "\\\\").replace("'", "\\'")
    command = [sys.executable, "-m", COMMAND, *sys.argv[1:], f"hydra.run.dir='{quoted}'"]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    shared = {
        "OMP_NUM_THREADS": str(max(1, cores // count)),
        **os.environ,
        LAUNCHER_PID: str(os.getpid()),
        "WORLD_SIZE": str(count),
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": str(find_free_network_port()),
        "NODE_RANK": "0",
    }
    processes: list[subprocess.Popen] = []
    for rank in range(count):
        own = {"RANK": str(rank), "LOCAL_RANK": str(rank), REPORT: str(reports / str(rank))}
        silent = None if rank == 0 else subprocess.DEVNULL
        with (reports / f"{rank}.stderr").open("wb") as errors:
            processes.append(
                subprocess.Popen(
                    command,
                    env={**shared, **own},
                    stdin=subprocess.DEVNULL,
                    stdout=silent,
                    stderr=None if rank == 0 else errors,
                    start_new_session=True,
                )
            )
    return processes


def _wait(processes: list[subprocess.Popen]) -> dict[int, int]:
    """Wait until all have ended well, or one has not: then the exit codes of those that have ended, by rank."""
    while True:
        codes = {rank: process.poll() for rank, process in enumerate(processes)}
        if any(codes.values()):
            break
        if all(code == 0 for code in codes.values()):
            return {}
        time.sleep(POLL_SECONDS)
    latest = time.monotonic() + GRACE_SECONDS
    while time.monotonic() < latest and any(process.poll() is None for process in processes):
        time.sleep(POLL_SECONDS)
    return {rank: process.returncode for rank, process in enumerate(processes) if process.poll()}


def _interrupt(first: subprocess.Popen) -> None:
    """Interrupt rank 0, which saves and exits; the other ranks are killed afterwards."""
    try:
        first.send_signal(signal.SIGINT)
        first.wait(STOP_SECONDS)
    except (subprocess.TimeoutExpired, KeyboardInterrupt):  # too slow, or interrupted once more
        return


def _kill(processes: list[subprocess.Popen]) -> None:
    for process in processes:
        if process.poll() is None:
            process.kill()
            process.wait()


def _report_failure(died: dict[int, int], count: int, reports: Path) -> None:
    """Raise or print the cause: a user's mistake first, then a killed process, then a bug."""
    told = {rank: report for rank in died if (report := read_report(reports / str(rank)))}
    for report in told.values():
        if report.explained:
            raise InputError(report.text)
    for rank, code in died.items():
        if code < 0:
            raise InputError(
                f"process {rank} of {count} was ended by {signal.Signals(-code).name}; the others were stopped: go on with the "
                f"same command plus resume=true"
            )
    if told:
        first = min(told.items(), key=lambda item: (any(word in item[1].text for word in SECONDARY_ERRORS), item[0]))[1].text
    else:
        first = "".join((reports / f"{rank}.stderr").read_text(errors="replace") for rank in died)
    print(first, file=sys.stderr)
    sys.exit(1)
