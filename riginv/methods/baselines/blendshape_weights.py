"""The method of tools without rig logic: blendshape weights by linear least squares, then controls by a table."""

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.methods.base import BatchedMethod
from riginv.methods.baselines.control_lookup import ControlLookup
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.solvers.bounded import bounded_least_squares


class BlendshapeWeights(BatchedMethod):
    """Solve for the weights of the primary shapes alone, and look the controls up.

    Args:
        ridge: penalty on the squared weights, mm^2 of mean squared error for a weight of 1.
        bounded: whether the weights stay in [0, 1] while they are solved for; else they are cut off afterwards.

    Raises:
        InputError: the rig has no blendshapes, or the ridge is not above 0.
    """

    batch_size = 256
    source = (
        "What capture tools do that have the shapes but not the rig (linear blendshape solvers with non-negative least "
        "squares or a ridge). No paper: the correctives are ignored, as such tools must; both bounds hold, not only the "
        "lower; the lookup inverts the curve of the one control that drives a shape and the fewest others, and knows no "
        "macros beside it."
    )

    def __init__(self, rig: RigInMeshSpace, ridge: float = 1e-4, bounded: bool = True) -> None:
        super().__init__(rig)
        if not ridge > 0:
            raise InputError(f"blendshape weights: ridge is {ridge}, expected above 0")
        self.ridge, self.bounded = ridge * rig.space.vertex_count, bounded

    @classmethod
    def unsuited(cls, rig: LinearRig) -> str:
        return "" if rig.has_blendshapes else "it has no blendshapes"

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        self.lookup = ControlLookup(self.rig)
        self.shapes = self.rig.linear_map[: self.rig.source.primary_count].double()
        self.gram = self.shapes @ self.shapes.T
        self.gram.diagonal().add_(self.ridge)

    def weights(self, coordinates: Tensor) -> Tensor:
        """The weights `(mesh, shape)` of the primary shapes for meshes `(mesh, coordinate)`."""
        right = coordinates.double() @ self.shapes.T
        if self.bounded:
            return bounded_least_squares(self.gram, right)
        return torch.cholesky_solve(right.T, torch.linalg.cholesky(self.gram)).T.clamp(0, 1)

    def solve(self, coordinates: Tensor) -> Tensor:
        return self.lookup(self.weights(coordinates))
