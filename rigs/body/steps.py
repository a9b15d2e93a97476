"""The coefficients of the body by a compiled kernel, with their vector-Jacobian product."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from riginv.geometry.kernels.library import Kernels, kernels_for

if TYPE_CHECKING:
    from rigs.body.rig import BodyRig


class BodySteps:
    """One evaluation of the body's coefficients, without autograd.

    Args:
        compiled: the kernels.
        body: the rig.
        angles: of the joints, `(batch, 3 * joint)`, radians.
        controls: `(batch, control)`; those that move the root count.

    Attributes:
        coefficients: `(batch, 12 * joint)`.
    """

    def __init__(self, compiled: Kernels, body: "BodyRig", angles: Tensor, controls: Tensor) -> None:
        self.compiled, self.body, self.angles = compiled, body, angles.detach().contiguous()
        batch, joints = len(angles), len(body.parents)
        self.move = controls[:, body.moves].detach().contiguous()
        self.worlds = self.angles.new_empty(batch, joints, 3, 4)
        self.skeleton = (body.frames.to(angles), body.offsets.to(angles), body.parent_rows, joints)
        compiled.call("skeleton", angles.dtype, self.angles, self.move, *self.skeleton, self.worlds, batch)
        self.coefficients = self.worlds[:, body.skinned].flatten(1)

    @classmethod
    def of(cls, body: "BodyRig", angles: Tensor, controls: Tensor) -> "BodySteps | None":
        """None where a gradient is needed, or there are no kernels for the tensors."""
        needs_graph = torch.is_grad_enabled() and (angles.requires_grad or controls.requires_grad)
        compiled = None if needs_graph else kernels_for(angles, controls)
        return None if compiled is None else cls(compiled, body, angles, controls)

    @torch.no_grad()
    def vjp(self, gradient: Tensor) -> Tensor:
        """A gradient `(batch, coefficient)` by the coefficients to one by the controls, `(batch, control)`."""
        of_worlds = torch.zeros_like(self.worlds).index_copy_(1, self.body.skinned, gradient.unflatten(1, (-1, 3, 4)))
        of_angles, of_move = torch.empty_like(self.angles), torch.empty_like(self.move)
        found = (self.worlds, of_worlds, of_angles, of_move, len(gradient))
        self.compiled.call("skeleton_pull", gradient.dtype, self.angles, *self.skeleton, *found)
        pulled = of_angles @ self.body.angles.to(of_angles).T
        pulled[:, self.body.moves] += of_move
        return pulled
