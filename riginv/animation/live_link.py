"""Live Link Face CSV: the 52 shapes of ARKit and the rotation of the head, in the app's format."""

from pathlib import Path

import numpy as np
import scipy
import torch
from torch import Tensor

from riginv.animation.animation import Animation
from riginv.animation.table import write_rows
from riginv.errors import InputError
from riginv.rig.arkit import LIVE_LINK_SHAPES, plain_name
from riginv.rig.interface import LinearRig, RigBackend
from riginv.solvers.bounded import bounded_least_squares

FILE = "live_link.csv"
ANGLES = [f"{part}{angle}" for part in ("Head", "LeftEye", "RightEye") for angle in ("Yaw", "Pitch", "Roll")]
TIMECODE_FPS = 60  # the app counts 60 frames per second in timecodes, at any recording rate
BATCH_SIZE = 4096  # frames: most rounds are for a few of them
RIDGE = 1e-5  # relative to a shape's squared size: distributes weights between equal shapes


def check(rig: RigBackend) -> None:
    """Raise InputError for a rig that has neither controls nor shapes with ARKit's names."""
    if not rig.arkit_deltas() and not named_controls(rig):
        raise InputError(
            f"formats: livelink needs ARKit's shapes, and rig '{rig.name}' has neither shapes nor controls of their names "
            f"(such as {LIVE_LINK_SHAPES[0]}); choose csv"
        )


def write(path: Path, animation: Animation, swap_mouth: bool = False) -> None:
    """Write a recording.

    Args:
        swap_mouth: exchange MouthLeft and MouthRight: some software swaps them relative to the app.
    """
    shapes = dict(zip(LIVE_LINK_SHAPES, arkit_weights(animation).T.tolist()))
    if swap_mouth:
        shapes["MouthLeft"], shapes["MouthRight"] = shapes["MouthRight"], shapes["MouthLeft"]
    angles = np.zeros((len(animation), len(ANGLES)))
    if animation.motion is not None:
        rotations = scipy.spatial.transform.Rotation.from_matrix(animation.motion[:, :3, :3].detach().cpu().double().numpy())
        angles[:, :3] = rotations.as_euler("YXZ")  # radians, as in the app
    values = np.concatenate([np.stack([shapes[name] for name in LIVE_LINK_SHAPES], axis=1), angles], axis=1)
    first = float(animation.frame_numbers[0]) / animation.fps
    rows = [
        [timecode(first + seconds), len(LIVE_LINK_SHAPES) + len(ANGLES), *(f"{value:.10f}" for value in row)]
        for seconds, row in zip(animation.seconds.tolist(), values.tolist())
    ]
    write_rows(path, ["Timecode", "BlendShapeCount", *LIVE_LINK_SHAPES, *ANGLES], rows)


def timecode(seconds: float) -> str:
    """A time as `HH:MM:SS:FF.fff`, with 60 frames per second."""
    thousandths = round(seconds * TIMECODE_FPS * 1000)
    whole, frames = divmod(thousandths, TIMECODE_FPS * 1000)
    minutes, seconds = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours % 24:02d}:{minutes:02d}:{seconds:02d}:{frames / 1000:06.3f}"


def named_controls(rig: RigBackend) -> dict[str, int]:
    """Index of the control with the name of each ARKit shape, ignoring case, underscores and prefixes."""
    found: dict[str, int] = {}
    for number, name in enumerate(rig.control_names):
        found.setdefault(plain_name(name), number)
    return {shape: found[shape.lower()] for shape in LIVE_LINK_SHAPES if shape.lower() in found}


def arkit_weights(animation: Animation) -> Tensor:
    """Weights `(frame, shape)` in [0, 1] of ARKit's shapes, in the order of `LIVE_LINK_SHAPES`.

    If every control of the rig is one of ARKit's, or the rig has no shapes of these names, they are the controls. Else they
    are the weights whose shapes, added linearly, are nearest to the rig's meshes.
    """
    rig, named = animation.rig, named_controls(animation.rig)
    shapes = {name[0].upper() + name[1:]: delta for name, delta in rig.arkit_deltas().items()}
    weights = torch.zeros(len(animation), len(LIVE_LINK_SHAPES), dtype=torch.float64)
    if not shapes or len(named) == len(rig.controls):
        for name, number in named.items():
            weights[:, LIVE_LINK_SHAPES.index(name)] = animation.controls[:, number].detach().cpu().double()
        return weights.clamp(0, 1)
    nearest = nearest_weights(rig, torch.stack(list(shapes.values())), animation.controls)
    for name, column in zip(shapes, nearest.T):
        weights[:, LIVE_LINK_SHAPES.index(name)] = column
    return weights


@torch.no_grad()
def nearest_weights(rig: RigBackend, deltas: Tensor, controls: Tensor) -> Tensor:
    """Weights `(frame, shape)` in [0, 1] whose shapes `(shape, vertex, 3)` sum to the meshes nearest to the rig's."""
    flat = deltas.flatten(1).double()
    gram = flat @ flat.T
    size = gram.diagonal()
    size.copy_(torch.where(size > 0, size * (1 + RIDGE), 1.0))  # zero shapes keep weight 0
    linear = rig if isinstance(rig, LinearRig) else None
    along = None if linear is None else linear.basis.flatten(1).double() @ flat.T
    found = []
    for batch in controls.split(BATCH_SIZE):
        if linear is None or along is None:
            target = (rig(batch) - rig.rest_vertices).flatten(1).double() @ flat.T
        else:
            target = (linear.coefficients(batch) - linear.neutral_coefficients()).double() @ along
        found.append(bounded_least_squares(gram, target))
    return torch.cat(found).cpu()
