"""Worker processes that are killed, stopped, crash, hang or talk nonsense: nothing is lost, nothing is left behind."""

import copy
import gc
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from riginv.runs.worker_process import WorkerRefusedError
from rigs.blender.pool import PoseLostError, WorkerPool
from tests.support.toy_worker import CRASHES, HANGS, NAMES, REFUSES, REST

TOY = str(Path(__file__).parents[1] / "support/toy_worker.py")
LOAD = {"file": "toy"}


def toys(workers=2, seconds=0.0, timeout_s=20.0, load=None):
    return WorkerPool([sys.executable, TOY, str(seconds)], load or LOAD, workers, timeout_s)


def poses(count):
    controls = np.random.default_rng(0).random((count, 3), np.float32)
    controls[:, 2] = 0
    return controls, REST * (1 + controls[:, :1, None]) + controls[:, 1:2, None]


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)


@pytest.mark.parametrize("count", [0, 1, 2, 33])
def test_poses_come_back_in_their_order(count):
    controls, expected = poses(count)
    with toys() as pool:
        np.testing.assert_allclose(pool.evaluate(NAMES, controls), expected, rtol=1e-6)
        answer, arrays = pool.describe()
        assert [control["name"] for control in answer["controls"]] == list(NAMES)
        np.testing.assert_array_equal(arrays["rest_vertices"], REST)


def test_controls_go_by_name_and_those_not_named_are_neutral():
    controls, _ = poses(5)
    with toys(workers=1) as pool:
        np.testing.assert_allclose(pool.evaluate(["tall"], controls[:, :1]), REST + controls[:, :1, None], rtol=1e-6)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize(("sent", "timeout_s"), [("SIGKILL", 20.0), ("SIGSEGV", 20.0), ("SIGSTOP", 1.5)])
def test_a_worker_that_is_killed_or_stopped_amid_poses_is_replaced(sent, timeout_s):
    controls, expected = poses(48)
    with toys(workers=2, seconds=0.02, timeout_s=timeout_s) as pool:
        pool.describe()
        struck = []

        def strike():
            wait_until(lambda: len(pool.process_ids()) == 2)
            time.sleep(0.3)
            for pid in pool.process_ids():
                os.kill(pid, getattr(signal, sent))
                struck.append(pid)

        striker = threading.Thread(target=strike)
        striker.start()
        found = pool.evaluate(NAMES, controls)
        striker.join()
        np.testing.assert_allclose(found, expected, rtol=1e-6)
        assert len(struck) == 2 and not set(struck) & set(pool.process_ids())
    wait_until(lambda: not any(alive(pid) for pid in struck))


@pytest.mark.parametrize(("trouble", "says"), [(CRASHES, "signal 6"), (HANGS, "no answer in 1 s")])
def test_a_pose_that_ends_every_worker_is_named_and_the_pool_lives_on(trouble, says):
    controls, expected = poses(20)
    bad = controls.copy()
    bad[7, 2] = trouble
    with toys(timeout_s=1.0) as pool:
        with pytest.raises(PoseLostError, match=rf"pose 7 cost 3 workers in a row.*{says}"):
            pool.evaluate(NAMES, bad)
        np.testing.assert_allclose(pool.evaluate(NAMES, controls), expected, rtol=1e-6)


def test_what_a_worker_refuses_is_told_at_once():
    controls, _ = poses(4)
    controls[2, 2] = REFUSES
    with toys() as pool:
        pool.describe()
        before = pool.process_ids()
        with pytest.raises(WorkerRefusedError, match="toy: trouble"):
            pool.evaluate(NAMES, controls)
        assert set(before) <= set(pool.process_ids())
    with toys(load={"file": "doll"}) as pool, pytest.raises(WorkerRefusedError, match="doll: there is no such toy"):
        pool.describe()


@pytest.mark.parametrize(
    ("program", "says"),
    [
        ("raise SystemExit('no bpy here')", "ended with code 1: no bpy here"),
        ("print('Blender 4.5')", "ended with code 0"),
        ("import sys; sys.stdout.write('riginv-worker 1\\n' + 'x' * 99)", "cannot be read"),
        ("import os; os.write(1, b'riginv-worker 1\\n' + b'\\2\\0\\0\\0{}'); input()", "cannot be read"),
        ("import time; time.sleep(99)", "no answer in 1 s"),
    ],
)
def test_a_program_that_is_no_worker_is_told_by_its_last_words(program, says):
    with WorkerPool([sys.executable, "-c", program], LOAD, timeout_s=1.0) as pool:
        with pytest.raises(PoseLostError, match=says):
            pool.describe()
        assert pool.process_ids() == []


def test_what_a_program_prints_before_the_worker_runs_is_skipped():
    banner = f"import runpy; print('Blender 4.5.15', flush=True); runpy.run_path({TOY!r}, run_name='__main__')"
    with WorkerPool([sys.executable, "-c", banner], LOAD) as pool:
        assert len(pool.describe()[0]["controls"]) == 3


def test_no_worker_outlives_its_pool():
    with toys() as pool:
        pool.evaluate(NAMES, poses(20)[0])
        workers = pool.process_ids()
        assert workers and all(map(alive, workers))
    wait_until(lambda: not any(map(alive, workers)))
    pool = toys()
    pool.describe()
    workers = pool.process_ids()
    del pool
    gc.collect()
    wait_until(lambda: not any(map(alive, workers)))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux tells a process that its parent was killed")
@pytest.mark.parametrize("ending", ["exit", "kill", "terminate"])
def test_no_worker_outlives_its_parent_even_amid_an_endless_pose(ending):
    parent = f"""
import sys, threading, time, numpy as np
from tests.rigs.test_blender_pool import toys, NAMES
pool = toys(timeout_s=600)
threading.Thread(target=pool.evaluate, args=(NAMES, np.array([[0, 0, {HANGS}]] * 2, np.float32)), daemon=True).start()
while len(pool.process_ids()) < 2: time.sleep(0.02)
time.sleep(0.5)
print(*pool.process_ids(), flush=True)
{"" if ending == "exit" else "time.sleep(600)"}
"""
    started = subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True, cwd=Path(TOY).parents[2])
    workers = [int(pid) for pid in started.stdout.readline().split()]
    assert len(workers) == 2
    {"kill": started.kill, "terminate": started.terminate, "exit": lambda: None}[ending]()
    started.wait(20)
    started.stdout.close()
    wait_until(lambda: not any(map(alive, workers)))


def test_a_pool_is_copied_without_its_workers():
    with toys(workers=1) as pool:
        pool.describe()
        for other in (copy.deepcopy(pool), pickle.loads(pickle.dumps(pool))):
            with other:
                assert other.process_ids() == []
                np.testing.assert_array_equal(other.evaluate(NAMES, np.zeros((1, 3), np.float32))[0], REST)
                assert not set(other.process_ids()) & set(pool.process_ids())


@pytest.mark.skipif(not hasattr(os, "fork"), reason="fork")
def test_a_forked_process_uses_workers_of_its_own():
    with toys(workers=1) as pool:
        pool.describe()
        workers = pool.process_ids()
        child = os.fork()
        if child == 0:
            pool.describe()
            fine = not set(workers) & set(pool.process_ids()) and all(map(alive, workers))
            pool.close()
            os._exit(0 if fine else 1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert pool.process_ids() == workers and all(map(alive, workers))
        pool.describe()


@pytest.mark.parametrize(("attempts", "says"), [(1, "opening the file ended the worker: "), (3, "cost 3 workers in a row")])
def test_a_file_that_ends_its_reader_is_opened_as_often_as_is_said(attempts, says, monkeypatch):
    started = []
    begin = subprocess.Popen.__init__
    monkeypatch.setattr(subprocess.Popen, "__init__", lambda self, *a, **k: (started.append(a), begin(self, *a, **k))[1])
    with toys(1, load={"file": "crash"}) as pool, pytest.raises(PoseLostError, match=says):
        pool.describe(attempts)
    assert len(started) == attempts
