"""A command without any weight, for the tests of sweeps: it does what its arguments say, and leaves a trace of each start."""

import json
import os
import signal
import sys
import time
from pathlib import Path

from riginv.launch.job_process import THREADS, exit_with_parent


def main() -> None:
    exit_with_parent()
    given = dict(text.split("=", 1) for text in sys.argv[1:])
    folder = Path(given["hydra.run.dir"].strip("'"))
    folder.mkdir(parents=True, exist_ok=True)
    starts = folder / "starts.txt"
    threads = {os.environ.get(name) for name in THREADS.split()}
    with starts.open("a") as file:
        file.write(f"{given.get('resume', 'false')} {'/'.join(map(str, threads))} {os.getpid()} {time.time()}\n")
    time.sleep(float(given.get("sleep", 0)))
    first = len(starts.read_text().splitlines()) == 1
    if given["do"] == "die" or (given["do"] == "die_once" and first):
        os.kill(os.getpid(), signal.SIGKILL)
    if given["do"] == "refuse":
        sys.exit("error: the mesh is not there")
    if given["do"] == "break":
        raise KeyError("a fault of ours")
    if given["do"] == "measure":
        metrics = {"rig_poses/mean_vertex_error_mm": float(given["error"]), "train/steps": 5}
        (folder / "metrics.json").write_text(json.dumps(metrics))
    (folder / "ended.txt").write_text(str(time.time()))


if __name__ == "__main__":
    main()
