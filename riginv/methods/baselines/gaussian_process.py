"""Gaussian-process regression with an unknown constant mean, its scales chosen by leaving one out, and its training poses."""

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.sampling.meshes import MeshSampler

WIDTHS = (1.0, 4.0, 16.0)  # of the kernel, as multiples of the median distance
NOISES = (1e-4, 1e-3, 1e-2)  # variance of the noise, relative to the kernel's scale
BATCH_SIZE = 500  # poses at a time


class GaussianProcess:
    """From inputs `(sample, input)` to outputs `(sample, output)`, all with the same multiquadric kernel.

    The multiquadric is no covariance, only a conditional one: its negative is positive definite for weights that add up to 0.
    So a constant is fitted along, under that condition: universal kriging. Width and noise are those of a small grid that
    predict each sample best from all the others, which the inverse gives in closed form.

    Attributes:
        left_out: the root mean square error of the outputs when each sample is predicted from the others.
    """

    def __init__(self, inputs: Tensor, outputs: Tensor) -> None:
        self.inputs, outputs = inputs.double(), outputs.double()
        squares = torch.cdist(self.inputs, self.inputs).square()
        count = len(squares)
        apart = squares[~torch.eye(count, dtype=torch.bool)]
        self.scale = float(apart.median().sqrt()) if len(apart) else 1.0
        self.scale = self.scale or 1.0
        right = torch.cat([outputs, outputs.new_zeros(1, outputs.shape[1])])
        self.left_out = torch.inf
        for width in WIDTHS:
            kernel = -(squares / self.scale**2 + width**2).sqrt()
            for noise in NOISES:
                border = kernel.new_ones(count, 1)
                upper = torch.cat([kernel + noise * torch.eye(count, dtype=torch.float64), border], dim=1)
                system = torch.cat([upper, torch.cat([border, border.new_zeros(1, 1)]).T])
                inverse = torch.linalg.pinv(system) if count < 3 else torch.linalg.inv(system)
                weights = inverse @ right
                errors = weights[:count] / inverse.diagonal()[:count, None].clamp_min(torch.finfo(torch.float64).tiny)
                error = float(errors.square().mean().sqrt())
                if error < self.left_out:
                    self.left_out, self.width, self.weights = error, width, weights

    def __call__(self, inputs: Tensor) -> Tensor:
        """The expected outputs `(mesh, output)` for inputs `(mesh, input)`."""
        squares = torch.cdist(inputs.double(), self.inputs).square()
        kernel = -(squares / self.scale**2 + self.width**2).sqrt()
        return kernel @ self.weights[:-1] + self.weights[-1]


class PrincipalComponents:
    """A linear map from mesh coordinates to a few numbers that distinguish samples.

    Args:
        samples: `(sample, coordinate)`.
        share: of the samples' variance that is kept.
        view: `(coordinate, seen)`: what of the coordinates is looked at; None: all.
    """

    def __init__(self, samples: Tensor, share: float, view: Tensor | None = None) -> None:
        seen = samples.double() if view is None else samples.double() @ view.double()
        self.mean = seen.mean(dim=0)
        _, sizes, directions = torch.linalg.svd(seen - self.mean, full_matrices=False)
        variance = sizes.square().cumsum(0)
        count = int((variance < share * variance[-1]).sum()) + 1
        self.map = directions[:count].T if view is None else view.double() @ directions[:count].T
        self.offset = self.mean @ directions[:count].T

    def __call__(self, coordinates: Tensor) -> Tensor:
        """Mesh coordinates `(mesh, coordinate)` as `(mesh, component)`."""
        return coordinates.double() @ self.map - self.offset


def training_poses(rig: RigInMeshSpace, sampler: MeshSampler, count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Mesh coordinates `(pose, coordinate)`, and how far the controls `(pose, control)` are from neutral, in ranges; the rest
    pose is the first of them.

    Raises:
        InputError: there are fewer than three poses, or the sampler draws meshes without their controls.
    """
    if count < 3:
        raise InputError(f"a regression on {count} poses was requested, expected at least 3")
    generator = generator_at(seed, "baseline poses")
    batches = [sampler.sample(min(BATCH_SIZE, count - start), generator) for start in range(0, count, BATCH_SIZE)]
    if "controls" not in batches[0]:
        raise InputError("the sampler of a regression draws meshes without their controls: choose sampler=rig_poses")
    neutral, span = rig.source.neutral_controls, rig.source.upper - rig.source.lower
    controls = torch.cat([neutral[None], *(batch["controls"] for batch in batches)])
    coordinates = torch.cat([rig(neutral[None]).detach(), *(batch["coordinates"] for batch in batches)])
    return coordinates[:count].double(), ((controls - neutral) / span)[:count].double()


def as_controls(rig: RigInMeshSpace, away: Tensor) -> Tensor:
    """Distances from neutral `(mesh, control)`, in ranges, as controls within the limits."""
    own = rig.source.neutral_controls.double() + away * (rig.source.upper - rig.source.lower).double()
    return own.to(rig.source.dtype).clamp(rig.source.lower, rig.source.upper)
