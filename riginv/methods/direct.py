"""Direct optimisation, the paper's point of comparison."""

import torch
from torch import Tensor

from riginv.config.values import PositiveFloat, PositiveInt
from riginv.methods.base import Method
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.solvers.objective import Objective
from riginv.solvers.starts import descend, first_start


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

    def __init__(
        self, rig: RigInMeshSpace, steps: PositiveInt = 30, first_steps: PositiveInt = 300, lr: PositiveFloat = 0.02
    ) -> None:
        super().__init__(rig)
        self.steps, self.first_steps, self.lr = steps, first_steps, lr

    @classmethod
    def unsuited(cls, rig: LinearRig) -> str:
        return "" if rig.differentiable else "no gradient passes through it"

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        self.objective = Objective(self.rig)
        _ = self.objective.features  # fitted now, not within the first set

    def invert(self, meshes: MeshSet) -> Tensor:
        coordinates = self.coordinates(meshes)
        alone = coordinates[:1] if meshes.fps else coordinates  # those that no frame comes before
        start = self.objective.to_controls(first_start(self.objective, alone))
        found = [descend(self.rig, start, alone, self.first_steps, self.lr)]
        for frame in range(len(alone), len(coordinates)):
            found.append(descend(self.rig, found[-1], coordinates[frame : frame + 1], self.steps, self.lr))
        return torch.cat(found)


class Neutral(Method):
    """Neutral controls for every mesh: the reference for all other methods."""

    source = "none: the yardstick at the lower end"

    def invert(self, meshes: MeshSet) -> Tensor:
        return self.rig.source.neutral_controls.expand(len(meshes), -1).clone()
