"""Whether a mesh is like those that a network has seen: a box around random poses and combinations, in mesh coordinates."""

import torch
from torch import Tensor

from riginv.data.test_sets import random_poses
from riginv.mesh_space import RigInMeshSpace
from riginv.sampling.meshes import random_weights
from riginv.sampling.seeds import generator_at

MESHES = 1024  # of each kind
WIDER = 1.1  # than what was seen


class TrainingRange:
    """The range of mesh coordinates that random poses of a rig, and random combinations of its shapes, span."""

    @torch.no_grad()
    def __init__(self, rig: RigInMeshSpace) -> None:
        self.space = rig.space
        pieces = [rig(controls) for controls in random_poses(rig.rig, MESHES, "training range").controls.split(256)]
        if rig.rig.has_blendshapes:
            weights = random_weights(len(rig.rig.basis), MESHES, generator_at(0, "training range"))
            pieces.append(weights.to(rig.linear_map) @ rig.linear_map)
        seen = torch.cat(pieces)
        self.low, self.high = WIDER * seen.amin(dim=0), WIDER * seen.amax(dim=0)

    def outside_mm(self, coordinates: Tensor) -> Tensor:
        """How far mesh coordinates `(frame, coordinate)` lie outside, `(frame,)`: root mean square over the vertices."""
        beyond = coordinates - coordinates.clamp(self.low, self.high)
        return beyond.norm(dim=1) / self.space.vertex_count**0.5
