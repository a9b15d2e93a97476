"""The motion of a skeleton in a USD stage (UsdSkel), for rigs whose mesh the stage does not hold."""

import sys
from pathlib import Path

import torch

from riginv.clips.bones import BonesClip, motion_of_worlds
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import SourceFacts
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.runs.worker_process import WorkerRefusedError
from rigs.blender.pool import PoseLostError, WorkerPool

SCRIPT = Path(__file__).parent / "play_bones.py"


def bones_clip(path: str, options: ReadingOptions, rig: RigBackend, timeout_s: float) -> BonesClip | None:
    """The animated skeleton in a stage as a clip of a rig; None where the stage has no skeleton.

    Raises:
        JointNamesError: its joints are not the rig's.
        InputError: the stage is damaged, or it is not clear which skeleton or animation is meant.
    """
    load = {"file": str(Path(path).absolute()), "animation": options.animation, "fps": options.fps}
    pool = WorkerPool([sys.executable, str(SCRIPT)], load, 1, timeout_s)
    try:
        facts, arrays = pool.describe(attempts=1)
    except WorkerRefusedError as error:
        raise InputError(" ".join(str(error).split())) from None
    except PoseLostError as error:
        raise InputError(f"{path}: the process that reads USD is lost: {error}") from None
    finally:
        pool.close()
    if not facts["joints"]:
        return None
    rest, worlds = (torch.tensor(arrays[name]) for name in ("rest", "worlds"))
    if not (torch.isfinite(rest).all() and torch.isfinite(worlds).all()):
        raise InputError(f"{path}: transforms of its joints are no finite numbers: damaged; export it again")
    motion = motion_of_worlds(facts["joints"], facts["parents"], rest, worlds, facts["fps"])
    motion = motion._replace(frame_numbers=arrays["frames"], up=facts["up"] or "y", unit_mm=facts["unit_mm"])
    source = SourceFacts(
        "USD, joints",
        animation=facts["animation"],
        other_animations=tuple(facts["other_animations"]),
        rate_source=facts["rate_source"],
        notes=("Its meshes are not the rig's: its joints move the rig.", *facts["notes"]),
    )
    return BonesClip(path, motion, rig, source)
