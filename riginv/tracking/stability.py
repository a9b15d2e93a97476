"""How still a rig keeps each vertex, and whether it can go anywhere by itself."""

import torch
from torch import Tensor

from riginv.evaluation.evaluation_sets import random_poses
from riginv.rig.batches import generator_at
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.sampling.meshes import random_weights

POSES = 64
QUIET = 0.3  # the share of vertices that move less than what counts as moving
RIGID = 1e-3  # the share of a move of all vertices that a rig's controls may leave undone, to count as doing it
OPEN = 1e-3  # of a control's range, away from neutral


@torch.no_grad()
def stability_weights(rig: RigBackend) -> Tensor:
    """How much each vertex counts when rigid motion is looked for, `(vertex,)` in (0, 1]: 1 where no pose moves it."""
    ways = [
        (vertices - rig.rest_vertices).norm(dim=2) for _, vertices in random_poses(rig, POSES, "stillness").batches(POSES // 4)
    ]
    way = torch.cat(ways).square().mean(dim=0).sqrt()
    typical = way.quantile(QUIET).clamp_min(1e-3 * way.max().clamp_min(1e-9))
    return 1 / (1 + (way / typical) ** 2)


@torch.no_grad()
def has_root_controls(rig: RigInMeshSpace) -> bool:
    """Whether controls of the rig move all of it along every axis, as those of a root do."""
    backend = rig.rig
    towards = torch.where(backend.neutral_controls + OPEN * (backend.upper - backend.lower) <= backend.upper, 1.0, -1.0)
    controls = backend.neutral_controls + OPEN * towards * (backend.upper - backend.lower)
    _, jacobian = backend.coefficient_jacobian(controls[None])
    derivatives = (jacobian.dense()[0].T @ rig.linear_map).double() * (backend.upper - backend.lower)[:, None].double()
    fields = torch.eye(3, dtype=torch.float64)[:, None].expand(3, rig.space.vertex_count, 3).flatten(1)
    wanted = fields @ rig.space.frame.double().flatten(1).T
    found = torch.linalg.lstsq(derivatives.T, wanted.T, driver="gelsd").solution
    left = fields.square().sum(dim=1) - wanted.square().sum(dim=1) + (wanted.T - derivatives.T @ found).square().sum(dim=0)
    return bool((left < RIGID * fields.square().sum(dim=1)).all())


MESHES = 1024  # of each kind
WIDER = 1.1  # than what was seen


class TrainingRange:
    """The range of mesh coordinates that random poses of a rig, and random combinations of its shapes, span."""

    @torch.no_grad()
    def __init__(self, rig: RigInMeshSpace) -> None:
        self.space = rig.space
        batches = [rig(controls) for controls in random_poses(rig.rig, MESHES, "training range").controls.split(256)]
        if rig.rig.has_blendshapes:
            weights = random_weights(len(rig.rig.basis), MESHES, generator_at(0, "training range"))
            batches.append(weights.to(rig.linear_map) @ rig.linear_map)
        seen = torch.cat(batches)
        self.low, self.high = WIDER * seen.amin(dim=0), WIDER * seen.amax(dim=0)

    def outside_mm(self, coordinates: Tensor) -> Tensor:
        """How far mesh coordinates `(frame, coordinate)` lie outside, `(frame,)`: root mean square over the vertices."""
        beyond = coordinates - coordinates.clamp(self.low, self.high)
        return beyond.norm(dim=1) / self.space.vertex_count**0.5
