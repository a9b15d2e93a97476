"""A process of a run ends with the one that watches it."""

import os
import subprocess
import sys


def test_a_process_ends_with_the_one_that_watches_it():
    code = "from riginv.launch.rank_process import exit_with_launcher; import time; exit_with_launcher(); time.sleep(60)"
    gone = subprocess.Popen([sys.executable, "-c", "pass"])
    gone.wait()
    orphan = subprocess.Popen([sys.executable, "-c", code], env={**os.environ, "RIGINV_LAUNCHER_PID": str(gone.pid)})
    assert orphan.wait(timeout=30) == 1
