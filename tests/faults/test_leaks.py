"""Workers whose memory grows with every pose are replaced before it is too much, and no pose is lost."""

import sys
import threading

import numpy as np
import psutil

from rigs.blender.pool import WorkerPool
from tests.faults.tally import fault
from tests.rigs.test_blender_pool import LOAD, TOY
from tests.support.toy_worker import LEAK_MB, LEAKS, NAMES, REST

POSES, ALLOWED_MB = 160, 50
SECONDS = 0.01  # for a pose


def watch(pool: WorkerPool, memory: dict[int, float], over: threading.Event) -> None:
    """The most that each worker holds, in MB, until it is over."""
    while not over.wait(0.02):
        for process in pool.process_ids():
            try:
                memory[process] = max(memory.get(process, 0.0), psutil.Process(process).memory_info().rss / 1e6)
            except psutil.Error:
                continue


def evaluate(growth_mb: float | None) -> dict[int, float]:
    """Evaluate poses that leak, and see that none is lost; the most memory of each worker, MB."""
    controls = np.random.default_rng(0).random((POSES, 3), np.float32)
    controls[:, 2] = LEAKS
    memory, over = {}, threading.Event()
    with WorkerPool([sys.executable, TOY, str(SECONDS)], LOAD, workers=1, growth_mb=growth_mb) as pool:
        watching = threading.Thread(target=watch, args=(pool, memory, over))
        watching.start()
        found = pool.evaluate(NAMES, controls)
        over.set()
        watching.join()
    np.testing.assert_allclose(found, REST * (1 + controls[:, :1, None]) + controls[:, 1:2, None], rtol=1e-6)
    return memory


def test_a_worker_that_leaks_is_replaced():
    unchecked = evaluate(None)
    assert len(unchecked) == 1 and max(unchecked.values()) > POSES * LEAK_MB
    memory = evaluate(ALLOWED_MB)
    workers = len(memory)
    with fault("worker that leaks memory", "replaced once it has grown too much; every pose comes back", workers - 1):
        assert workers > 3
        assert max(memory.values()) < max(unchecked.values()) / 2, memory
