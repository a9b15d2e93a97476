"""Pictures of the worst and the median pose, in TensorBoard."""

import lightning as L
import numpy as np
import torch
from torch import Tensor

from riginv.modules.base import RigModule
from riginv.render import Camera, grid, heat_colors
from riginv.sampling.meshes import PoseBatch


class PosePictures(L.Callback):
    """Shows, for each validation set, its worst and its median pose: what was asked for, what came out, and the error.

    Args:
        every_n_validations: how often; the last validation is always shown.
    """

    def __init__(self, every_n_validations: int) -> None:
        self.every_n_validations, self.validations = every_n_validations, 0

    def on_validation_end(self, trainer: L.Trainer, module: RigModule) -> None:
        if trainer.sanity_checking:
            return
        self.validations += 1
        if self.validations % self.every_n_validations and trainer.global_step < trainer.max_steps:
            return
        for name, batch in trainer.datamodule.validation.items():
            picture = worst_and_median(module, {key: values.to(module.device) for key, values in batch.items()})
            module.logger.experiment.add_image(f"poses/{name}", picture, trainer.global_step, dataformats="HWC")


@torch.no_grad()
def worst_and_median(module: RigModule, batch: PoseBatch) -> np.ndarray:
    """A picture `(height, width, 3)`: rows worst and median pose; columns target, result, and error up to its largest."""
    space, rig = module.rig.space, module.rig.rig
    difference = module.reconstruct(batch) - batch["coordinates"]
    order = difference.square().sum(dim=1).argsort(descending=True)
    camera, colors = Camera(space.rest_vertices), rig.vertex_colors()
    colors = None if colors is None else colors.cpu()
    pictures, labels = [], []
    for label, row in (("worst", order[0]), ("median", order[len(order) // 2])):
        target = space.decode(batch["coordinates"][row][None])[0]
        result = target + (space.decode(difference[row][None])[0] - space.rest_vertices)
        distances: Tensor = (result - target).norm(dim=1)
        top = float(distances.max())
        pictures += [camera.picture(target, rig.faces, colors), camera.picture(result, rig.faces, colors)]
        pictures += [camera.picture(result, rig.faces, heat_colors(distances, top))]
        labels += [f"{label}: target", "result", f"error, mean {float(distances.mean()):.2f}, red {top:.1f} mm"]
    return np.asarray(grid(pictures, labels, columns=3))
