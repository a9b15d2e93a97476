"""From blendshape weights back to controls, by a table, as tools do that have the shapes but not the rig's logic."""

from typing import NamedTuple

import torch
from torch import Tensor

from riginv.methods.baselines.sides import Sides
from riginv.rig.mesh_space import RigInMeshSpace

KNOTS = 32  # of each table
MIN_EFFECT = 0.1  # relative to a side's largest effect: below it a shape is not attributed to the side
MIN_DRIVER = 0.5  # relative to a shape's strongest driver: weaker sides are not candidates


class Entry(NamedTuple):
    """A shape that determines the weight of one side.

    Attributes:
        shape, side: indices.
        curve: the shape's weight at each knot of the side's, `(knot,)`, never falling.
    """

    shape: int
    side: int
    curve: Tensor


class ControlLookup:
    """The control that each shape determines, and the curve between the two; measured from the rig, one control at a time.

    Each shape is assigned to the side that drives it and the fewest other shapes. A control takes the mean over its shapes;
    without any it stays neutral; of its two sides the one with the greater weight is used.

    Args:
        rig: one with blendshapes.
    """

    def __init__(self, rig: RigInMeshSpace) -> None:
        self.sides, shapes = Sides(rig.source), rig.source.primary_count
        knots = torch.arange(1, KNOTS + 1, dtype=torch.float64) / KNOTS
        poses = (torch.eye(len(self.sides), dtype=torch.float64)[:, None] * knots[:, None]).flatten(0, 1)
        with torch.no_grad():
            pieces = [rig.source.coefficients(self.sides.controls(piece))[:, :shapes].double() for piece in poses.split(512)]
        curves = torch.cat(pieces).unflatten(0, (len(self.sides), KNOTS))
        full = curves[:, -1]
        drives = (full > MIN_EFFECT * full.amax(dim=1, keepdim=True)).sum(dim=1)
        self.entries = []
        for shape in range(shapes):
            rivals = (full[:, shape] >= MIN_DRIVER * full[:, shape].max()).nonzero()[:, 0]
            if full[:, shape].max() > MIN_EFFECT and len(rivals):
                side = int(rivals[drives[rivals].argmin()])
                curve = torch.cat([torch.zeros(1, dtype=torch.float64), curves[side, :, shape]]).cummax(dim=0).values
                self.entries.append(Entry(shape, side, curve))

    def __call__(self, weights: Tensor) -> Tensor:
        """Weights of the primary shapes `(mesh, shape)` to controls `(mesh, control)`, within the limits."""
        total = weights.new_zeros(len(weights), len(self.sides))
        counts = weights.new_zeros(len(self.sides))
        for shape, side, curve in self.entries:
            total[:, side] += _where(curve, weights[:, shape].contiguous())
            counts[side] += 1
        found = total / counts.clamp_min(1)
        for group in self.sides.groups:
            if len(group) == 2:
                up, down = found[:, group[0]].clone(), found[:, group[1]].clone()
                found[:, group[0]], found[:, group[1]] = torch.where(up >= down, up, 0.0), torch.where(down > up, down, 0.0)
        return self.sides.controls(found)


def _where(curve: Tensor, values: Tensor) -> Tensor:
    """The first position in [0, 1] at which a curve that never falls reaches each value; 1 where it never does."""
    place = torch.searchsorted(curve, values).clamp(1, len(curve) - 1)
    before, after = curve[place - 1], curve[place]
    fraction = ((values - before) / (after - before).clamp_min(torch.finfo(values.dtype).eps)).clamp(0, 1)
    return (place - 1 + fraction) / (len(curve) - 1)
