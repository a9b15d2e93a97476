"""A second speaker of the worker protocol: a rig of plain NumPy, with no Blender in sight, and poses that end or hang it.

python toy_worker.py [SECONDS_PER_POSE]
"""

import os
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "rigs/blender/in_blender"))
from worker import RefusedError, serve

NAMES = ("wide", "tall", "trouble")
REST = np.arange(12, dtype=np.float32).reshape(4, 3)
CRASHES, HANGS, REFUSES, LEAKS = 1.0, 2.0, 3.0, 4.0  # values of the control `trouble`
LEAKED, LEAK_MB = [], 5


class ToyScene:
    def load(self, file):
        if file == "crash":
            os.abort()
        if file != "toy":
            raise RefusedError(f"{file}: there is no such toy")
        print("a print that must not disturb the protocol")
        os.write(1, b"nor must one past Python\n")
        return {}, {}

    def describe(self):
        controls = [{"name": name, "lower": 0.0, "upper": 1.0, "neutral": 0.0, "unit": ""} for name in NAMES]
        return {"controls": controls}, {"rest_vertices": REST, "faces": np.array([[0, 1, 2]], np.int32)}

    def evaluate(self, names, controls):
        meshes = []
        for row in controls:
            time.sleep(float(sys.argv[1]) if len(sys.argv) > 1 else 0)
            values = dict.fromkeys(NAMES, 0.0) | dict(zip(names, row.tolist()))
            if values["trouble"] == CRASHES:
                os.abort()
            while values["trouble"] == HANGS:
                time.sleep(1)
            if values["trouble"] == LEAKS:
                LEAKED.append(np.ones(LEAK_MB * 125_000))
            if values["trouble"] == REFUSES:
                raise RefusedError("toy: trouble")
            meshes.append(REST * (1 + values["wide"]) + values["tall"])
        return {}, {"vertices": np.array(meshes, np.float32).reshape(-1, 4, 3)}


if __name__ == "__main__":
    serve(ToyScene())
