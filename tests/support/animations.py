"""Small animations of small rigs, and Blender as the reader of what is written of them."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from riginv.animation.animation import Animation, FrameErrors
from riginv.rig.interface import RigBackend
from tests.support.blends import blender

NUMBERS = torch.tensor([101, 102, 103, 104, 107, 108, 110, 111, 112, 113, 114, 115])  # with gaps
UPRIGHT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # y up to Blender's z up


def moving(rig: RigBackend, fps: float = 25.0, numbers: torch.Tensor = NUMBERS, with_motion: bool = True) -> Animation:
    """Smooth curves over the whole range of every control, on a mesh that turns and goes somewhere."""
    generator = torch.Generator().manual_seed(7)
    phases, speeds = torch.rand(2, 1, len(rig.controls), generator=generator)
    waves = 0.5 + 0.5 * torch.sin(6.28 * (phases + (0.5 + speeds) * (numbers[:, None] - numbers[0]) / 25.0))
    controls = rig.lower + (rig.upper - rig.lower) * (0.35 * waves + 0.2)
    motion = None
    if with_motion:
        along = np.linspace(0, 1, len(numbers))
        motion = np.broadcast_to(np.eye(4), (len(numbers), 4, 4)).copy()
        motion[:, :3, :3] = Rotation.from_euler("xyz", np.outer(along, [40.0, 250.0, -30.0]), degrees=True).as_matrix()
        motion[:, :3, 3] = np.outer(along, [100.0, -50.0, 30.0])
        motion = torch.tensor(motion)
    return Animation(rig, controls, fps, numbers, motion, "take", {"bundle": "0123abcd", "method": "network"})


def errors_of(animation: Animation) -> FrameErrors:
    rows = range(len(animation))
    mean = torch.linspace(0.1, 0.4, len(animation))
    flags = [["outside_reach", "not_converged"] if row == 3 else [] for row in rows]
    regions = ["mouth" if row % 2 else "" for row in rows]
    return FrameErrors(mean, 3 * mean, torch.arange(len(animation)), regions, flags)


def meshes_of(animation: Animation) -> np.ndarray:
    """The meshes in the world `(frame, vertex, 3)`, mm, by the rig itself."""
    with torch.no_grad():
        meshes = animation.rig(animation.controls).double()
    if animation.motion is not None:
        meshes = meshes @ animation.motion[:, :3, :3].mT + animation.motion[:, None, :3, 3]
    return meshes.numpy()


def in_blender(folder: Path, script: str, **facts) -> dict[str, np.ndarray]:
    """Run a script in Blender that fills `found` with arrays; `facts` stand in its variable `facts`."""
    program = (
        "import bpy, json, os, sys\nimport numpy as np\n"
        "bpy.ops.wm.read_factory_settings(use_empty=True)\nscene = bpy.context.scene\n"
        f"facts = json.loads({json.dumps(json.dumps(facts))})\nfound = {{}}\n{BITS}\n{script}\n"
        f"np.savez({str(folder / 'found.npz')!r}, **found)\nsys.stdout.flush()\nos._exit(0)\n"
    )
    (folder / "read.py").write_text(program)
    environment = {**os.environ, "TMPDIR": str(folder)}
    done = subprocess.run([blender(), str(folder / "read.py")], capture_output=True, text=True, timeout=120, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    with np.load(folder / "found.npz") as file:
        return {name: file[name] for name in file.files}


BITS = """
def points(thing):
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    co = np.empty(3 * len(evaluated.data.vertices), np.float32)
    evaluated.data.vertices.foreach_get("co", co)
    matrix = np.array(evaluated.matrix_world, np.float64)
    return co.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]

def at(time):
    scene.frame_set(int(time // 1), subframe=time % 1)

def the(kind):
    found = [thing for thing in bpy.data.objects if thing.type == kind]
    return max(found, key=lambda thing: len(getattr(thing.data, "vertices", [])))
"""


def has_usd():
    try:
        import pxr  # noqa: F401
    except ImportError:
        return False
    return True


def near(found, expected, mm):
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() < mm
