"""Properties of a rig that an inversion needs: vertex stability, root controls, the range of its meshes."""

import torch
from torch import Tensor

from riginv.evaluation.evaluation_sets import random_poses
from riginv.rig.batches import generator_at
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.sampling.meshes import random_weights

POSES = 64
QUANTILE = 0.3  # of the vertex displacements: the scale of stability
RIGID = 1e-3  # squared fraction of a translation that the controls may fail to make
OFFSET = 1e-3  # of a control's range, from neutral, where derivatives are taken


@torch.no_grad()
def stability_weights(rig: RigBackend) -> Tensor:
    """The weight of each vertex in rigid registration, `(vertex,)` in (0, 1]: 1 where no pose moves it."""
    distances = [
        (vertices - rig.rest_vertices).norm(dim=2) for _, vertices in random_poses(rig, POSES, "stillness").batches(POSES // 4)
    ]
    distance = torch.cat(distances).square().mean(dim=0).sqrt()
    scale = distance.quantile(QUANTILE).clamp_min(1e-3 * distance.max().clamp_min(1e-9))
    return 1 / (1 + (distance / scale) ** 2)


@torch.no_grad()
def has_root_controls(rig: RigInMeshSpace) -> bool:
    """Whether controls of the rig translate all of it along every axis, as those of a root joint do."""
    backend = rig.source
    direction = torch.where(backend.neutral_controls + OFFSET * (backend.upper - backend.lower) <= backend.upper, 1.0, -1.0)
    controls = backend.neutral_controls + OFFSET * direction * (backend.upper - backend.lower)
    _, jacobian = backend.coefficient_jacobian(controls[None])
    derivatives = (jacobian.dense()[0].T @ rig.linear_map).double() * (backend.upper - backend.lower)[:, None].double()
    fields = torch.eye(3, dtype=torch.float64)[:, None].expand(3, rig.space.vertex_count, 3).flatten(1)
    target = fields @ rig.space.directions.double().flatten(1).T
    found = torch.linalg.lstsq(derivatives.T, target.T, driver="gelsd").solution
    outside = fields.square().sum(dim=1) - target.square().sum(dim=1)
    residual = outside + (target.T - derivatives.T @ found).square().sum(dim=0)
    return bool((residual < RIGID * fields.square().sum(dim=1)).all())


MESHES = 1024  # of each kind
MARGIN = 1.1


class TrainingRange:
    """The range of mesh coordinates of random poses of a rig and random combinations of its shapes."""

    @torch.no_grad()
    def __init__(self, rig: RigInMeshSpace) -> None:
        self.space = rig.space
        poses = random_poses(rig.source, MESHES, "training range").controls
        assert poses is not None
        batches = [rig(controls) for controls in poses.split(256)]
        if rig.source.has_blendshapes:
            weights = random_weights(len(rig.source.basis), MESHES, generator_at(0, "training range"))
            batches.append(weights.to(rig.linear_map) @ rig.linear_map)
        seen = torch.cat(batches)
        self.low, self.high = MARGIN * seen.amin(dim=0), MARGIN * seen.amax(dim=0)

    def outside_mm(self, coordinates: Tensor) -> Tensor:
        """Distance of mesh coordinates `(frame, coordinate)` from the range, `(frame,)`, mm: root mean square over vertices."""
        beyond = coordinates - coordinates.clamp(self.low, self.high)
        return beyond.norm(dim=1) / self.space.vertex_count**0.5
