"""An inversion as TensorBoard events: errors and controls by frame, and the contact sheet."""

from pathlib import Path

import numpy as np
import torch
from PIL import Image

from riginv.animation.animation import Animation, FrameErrors

MAX_POINTS = 1000  # of a curve, as many as TensorBoard shows by default


def write_tensorboard(folder: Path, animation: Animation, errors: FrameErrors, sheet: Path | None = None) -> None:
    """Write events whose steps are frame numbers.

    Args:
        folder: for `tensorboard --logdir`.
        sheet: PNG of `write_sheet`.
    """
    evaluated = animation.frame_numbers if errors.frame_numbers is None else errors.frame_numbers
    from torch.utils.tensorboard import SummaryWriter  # only for formats=[tensorboard]

    with SummaryWriter(str(folder)) as writer:
        for row in _spread(len(evaluated)):
            for name, values in (("mean_vertex_error_mm", errors.mean_mm), ("max_vertex_error_mm", errors.max_mm)):
                writer.add_scalar(f"errors/{name}", float(values[row]), int(evaluated[row]))
            writer.add_scalar("errors/flags", len(errors.flags[row]), int(evaluated[row]))
        controls = animation.controls.detach().cpu()
        for row in _spread(len(animation)):
            for control, value in zip(animation.rig.controls, controls[row].tolist()):
                writer.add_scalar(f"controls/{control.name}", value, int(animation.frame_numbers[row]))
        if sheet is not None:
            with Image.open(sheet) as picture:
                writer.add_image("meshes", torch.tensor(np.asarray(picture.convert("RGB"))), dataformats="HWC")


def _spread(count: int) -> list[int]:
    return sorted(set(np.linspace(0, count - 1, min(count, MAX_POINTS)).round().astype(int).tolist()))
