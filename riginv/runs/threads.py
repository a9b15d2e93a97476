"""A thread pool for tensor tasks, sized by the number of free cores.

Operations here are small. Several threads within one operation wait for each other thousands of times a second, and where
another process takes one's core all others wait for it too. So work is cut into parts, each part is computed by one thread, and
what comes out does not depend on how many threads there are.
"""

import contextvars
import functools
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import psutil
import torch

from riginv.errors import counted

THREADS_VARIABLE = "RIGINV_THREADS"  # environment variable: fixes the number of threads
LIMIT = "OMP_NUM_THREADS"  # an upper limit, where it is set
SECONDS = 2.0  # between two looks at what other processes do
SHORTEST = 0.25  # s: over less time the operating system's clocks are too coarse
BUSY_FRACTION = 0.4  # a core of which others use less than this counts as free
Result = TypeVar("Result")


class Cores:
    """The cores that this process may use, and how many of them other processes leave free.

    Attributes:
        count: their number, by affinity and by the limits of a container.
    """

    def __init__(self) -> None:
        self.numbers = allowed_cores()
        self.count = max(1, min(len(self.numbers), _container_limit()))
        self._before = self._clocks()

    def free(self) -> float | None:
        """The mean number of cores that were free or used by this process since the last call; None directly after a call."""
        now = self._clocks()
        seconds = now[0] - self._before[0]
        if seconds < SHORTEST:
            return None
        others = (now[1] - self._before[1]) - (now[2] - self._before[2])
        self._before = now
        return max(0.0, self.count - max(0.0, others) / seconds)

    def _clocks(self) -> tuple[float, float, float]:
        """The time, and the CPU seconds on these cores of all processes and of this one."""
        cores = psutil.cpu_times(percpu=True)
        busy = 0.0
        for number in self.numbers:
            if number < len(cores):
                times = cores[number]._asdict()
                busy += sum(times.get(kind, 0.0) for kind in ("user", "nice", "system", "irq", "softirq", "steal"))
        own = psutil.Process().cpu_times()
        return time.monotonic(), busy, own.user + own.system


class Workers:
    """Computes a few tasks at once, each in a thread of its own.

    Args:
        threads: their number; None: the number of free cores, counted every few seconds.
        most: the largest number of threads; None: all cores.

    Attributes:
        count: the present number of threads.
    """

    def __init__(self, threads: int | None = None, most: int | None = None) -> None:
        self.chosen = threads if threads is not None else _from_environment()
        self.cores = Cores()
        self.most = most or max(self.cores.count, self.chosen or 1)
        self.count = min(self.chosen, self.most) if self.chosen else 1
        self._looked = -1.0
        self._pool: ThreadPoolExecutor | None = None
        self._working = threading.local()

    @property
    def bound(self) -> int:
        """The largest number of threads that free cores may make it."""
        return min(self.cores.count, self.most, _limit())

    @property
    def counts_cores(self) -> bool:
        """Whether the number of threads follows the free cores; counting takes time, so not where it can only be 1."""
        return self.chosen is None and self.bound > 1

    def update_count(self) -> int:
        """Count the free cores, every few seconds at most; returns the number of threads to use."""
        now = time.monotonic()
        if self.counts_cores and not 0 <= now - self._looked < SECONDS:
            free = self.cores.free()
            if free is None and self._looked < 0:
                time.sleep(SHORTEST)
                free = self.cores.free()
            if free is not None:
                self.count = max(1, min(int(free + BUSY_FRACTION), self.bound))
                self._looked = now
        return self.count

    def run(self, tasks: Sequence[Callable[[], Result]]) -> list[Result]:
        """The results of tasks, in their order. Tasks within a task are computed by the same thread."""
        if getattr(self._working, "nested", False):
            return [task() for task in tasks]
        count = min(self.update_count(), len(tasks))
        with single_threaded():
            if count <= 1:
                return [task() for task in tasks]
            waiting = iter(enumerate(tasks))
            results: dict[int, Result] = {}
            lock = threading.Lock()

            def work() -> None:
                self._working.nested = True
                try:
                    while True:
                        with lock:
                            number, task = next(waiting, (len(tasks), None))
                        if task is None:
                            return
                        results[number] = task()
                except BaseException:
                    with lock:
                        for _ in waiting:  # the others have nothing more to do
                            pass
                    raise
                finally:
                    self._working.nested = False

            learning = torch.is_grad_enabled()
            futures = [self._threads().submit(contextvars.copy_context().run, _alone, work, learning) for _ in range(count - 1)]
            try:
                work()
            finally:
                for future in futures:
                    future.result()
            return [results[number] for number in range(len(tasks))]

    def describe(self) -> str:
        """The number of threads and how it was chosen, in a few words."""
        threads = counted(self.count, "thread")
        if self.chosen is not None:
            return f"{threads}, as configured"
        how = f" (free cores are counted every {SECONDS:g} s)" if self.counts_cores else ""
        return f"{threads} of {counted(self.cores.count, 'core')}{how}"

    def _threads(self) -> ThreadPoolExecutor:
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.most, thread_name_prefix="riginv")
        return self._pool


@functools.cache
def workers() -> Workers:
    """The threads that solvers use."""
    shared = Workers()
    if shared.cores.numbers == _SINCE_IMPORT.numbers:
        shared.cores = _SINCE_IMPORT  # so that the first look need not wait
    return shared


@contextmanager
def single_threaded() -> Iterator[None]:
    """A context in which each tensor operation of this thread runs on this thread alone."""
    before = torch.get_num_threads()
    if before == 1:
        yield
        return
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _alone(work: Callable[[], None], learning: bool) -> None:
    torch.set_num_threads(1)
    with torch.set_grad_enabled(learning):
        work()


def allowed_cores() -> list[int]:
    """The numbers of the cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def _container_limit() -> int:
    """Whole cores of a container's quota (cgroup v2, v1); all cores where there is no quota."""
    try:
        version_2 = Path("/sys/fs/cgroup/cpu.max")
        if version_2.is_file():
            quota, period = version_2.read_text().split()[:2]
        else:
            folder = Path("/sys/fs/cgroup/cpu")
            quota, period = ((folder / f"cpu.cfs_{name}_us").read_text().strip() for name in ("quota", "period"))
        return max(1, int(quota) // int(period)) if quota.isdigit() and int(period) > 0 else os.cpu_count() or 1
    except (OSError, ValueError):
        return os.cpu_count() or 1


def _from_environment() -> int | None:
    found = os.environ.get(THREADS_VARIABLE, "")
    return max(1, int(found)) if found.isdigit() else None


def _limit() -> int:
    found = os.environ.get(LIMIT, "").partition(",")[0]
    return max(1, int(found)) if found.isdigit() else os.cpu_count() or 1


_SINCE_IMPORT = Cores()  # counts from here on what other processes use
