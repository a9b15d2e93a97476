"""Direct optimisation, as the paper compares itself with."""

import torch
from torch import Tensor

from riginv.data.mesh_sets import MeshSet
from riginv.mesh_space import RigInMeshSpace
from riginv.methods.base import Method
from riginv.solvers.objective import Objective
from riginv.solvers.starts import first_start


class Direct(Method):
    """Adam on the controls of each frame; in a clip each frame starts where the one before ended.

    Args:
        steps: of Adam, for each frame.
        first_steps: for the first frame of a clip, and for every mesh that has no frame before it.
        lr: step size, of a control's range.
    """

    source = (
        "Rig inversion by training a differentiable rig function (SIGGRAPH Asia 2022), 'direct optimisation': gradient descent "
        "through the rig on each frame's controls, from the frame before. Changed: the loss is taken in mesh coordinates, "
        "where it is the same but for a constant; controls are clamped to their limits after each step; the paper leaves "
        "steps and rate open. The first frame starts a little away from neutral, on the side of each control that helps the "
        "mesh more: at neutral itself rigs have a kink that a descent may never leave."
    )

    def __init__(self, rig: RigInMeshSpace, steps: int = 30, first_steps: int = 300, lr: float = 0.02) -> None:
        super().__init__(rig)
        self.steps, self.first_steps, self.lr = steps, first_steps, lr

    def invert(self, meshes: MeshSet) -> Tensor:
        coordinates = self.coordinates(meshes)
        alone = coordinates[:1] if meshes.fps else coordinates  # those that no frame comes before
        objective = Objective(self.rig)
        start = objective.own_units(first_start(objective, alone))
        found = [self._descend(start, alone, self.first_steps)]
        for frame in range(len(alone), len(coordinates)):
            found.append(self._descend(found[-1], coordinates[frame : frame + 1], self.steps))
        return torch.cat(found)

    def _descend(self, start: Tensor, coordinates: Tensor, steps: int) -> Tensor:
        """The best controls `(mesh, control)` met on the way."""
        rig = self.rig.rig
        span = rig.upper - rig.lower
        unit = ((start - rig.lower) / span).detach().clone().requires_grad_()  # every control runs from 0 to 1: one rate fits
        optimizer = torch.optim.Adam([unit], lr=self.lr)
        best, least = start.clone(), torch.full((len(start),), torch.inf, dtype=start.dtype)
        for _ in range(steps):
            errors = (self.rig(rig.lower + span * unit) - coordinates).square().sum(dim=1)
            better = errors.detach() < least
            best = torch.where(better[:, None], (rig.lower + span * unit).detach(), best)
            least = torch.where(better, errors.detach(), least)
            optimizer.zero_grad()
            (errors.sum() / self.rig.space.vertex_count).backward()
            optimizer.step()
            with torch.no_grad():
                unit.clamp_(0, 1)
        return best.clamp(rig.lower, rig.upper)
