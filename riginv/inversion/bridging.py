"""Frames of which nothing is known: their neighbours stand in."""

import roma
import torch
from torch import Tensor


def bridged(controls: Tensor, known: Tensor, numbers: Tensor) -> Tensor:
    """Controls `(frame, control)`, on a straight line between the nearest known frames where they are not known `(frame,)`.

    Args:
        numbers: of the frames, `(frame,)`, as time goes by.
    """
    before, after, share = _neighbours(known, numbers)
    return controls[before] + share[:, None].to(controls) * (controls[after] - controls[before])


def bridged_motion(motion: Tensor, known: Tensor, numbers: Tensor) -> Tensor:
    """Rigid motions `(frame, 4, 4)`, likewise; rotations go the shortest way."""
    before, after, share = _neighbours(known, numbers)
    result = bridged(motion.flatten(1), known, numbers).unflatten(1, (4, 4))
    turn = roma.rotvec_to_rotmat(
        share[:, None].to(motion) * roma.rotmat_to_rotvec(motion[before, :3, :3].mT @ motion[after, :3, :3])
    )
    result[:, :3, :3] = torch.where(known[:, None, None], motion[:, :3, :3], motion[before, :3, :3] @ turn)
    return result


def _neighbours(known: Tensor, numbers: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """For each frame the known ones before and after it, and how far it is on the way, in [0, 1]."""
    frames = torch.arange(len(known))
    last = torch.where(known, frames, -1).cummax(dim=0).values
    next_one = torch.where(known, frames, len(known)).flip(0).cummin(dim=0).values.flip(0)
    before = torch.where(last < 0, next_one, last)
    after = torch.where(next_one == len(known), last, next_one)
    apart = (numbers[after] - numbers[before]).clamp_min(1)
    return before, after, (numbers - numbers[before]).double() / apart
