"""A step of damped quadratic models within a box, for many meshes at once."""

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.geometry.kernels.library import Kernels, kernels_for

ROUNDS = 3  # of solving, and fixing controls that leave the box
FLOOR = 1e-3  # of the mean curvature, added under damping: so controls without effect are damped, too


def damping_diagonal(
    hessian: Float[Tensor, "mesh control control"], damping: Float[Tensor, " mesh"]
) -> Float[Tensor, "mesh control"]:
    """Marquardt's damping: the addition `(mesh, control)` to the diagonals of Hessians, by factors `(mesh,)`."""
    diagonal = hessian.diagonal(dim1=1, dim2=2)
    floor = FLOOR * diagonal.mean(dim=1, keepdim=True) + torch.finfo(hessian.dtype).tiny
    return damping[:, None] * (diagonal + floor)


def predicted_change(
    hessian: Float[Tensor, "mesh control control"], gradient: Float[Tensor, "mesh control"], step: Float[Tensor, "mesh control"]
) -> Float[Tensor, " mesh"]:
    """The change of each mesh's quadratic model by a step, `(mesh,)`: negative where it descends."""
    compiled = kernels_for(hessian, gradient, step)
    if compiled is None:
        return (gradient * step).sum(dim=1) + 0.5 * (step * (hessian @ step[..., None])[..., 0]).sum(dim=1)
    result = gradient.new_empty(len(gradient))
    given = (hessian.contiguous(), gradient.contiguous(), step.contiguous(), result, gradient.shape[1], len(gradient))
    compiled.call("foreseen", gradient.dtype, *given)
    return result


def box_step(
    matrix: Float[Tensor, "mesh control control"],
    gradient: Float[Tensor, "mesh control"],
    at: Float[Tensor, "mesh control"],
    diagonal: Float[Tensor, "mesh control"] | None = None,
) -> Float[Tensor, "mesh control"]:
    """The step `(mesh, control)` that approximately minimises quadratic models over the box from 0 to 1.

    An active-set method: controls at a limit that the gradient pushes outward are fixed, the others solved for; those that
    would leave the box are fixed at their limit, and the rest is solved again, a few times. Matrices that are not positive
    definite in their own precision are factorised in float64; where that fails, too, the step is 0.

    Args:
        at: the current controls in [0, 1].
        diagonal: added to those of the matrices, such as damping.
    """
    compiled = kernels_for(matrix, gradient, at)
    if compiled is not None:
        return _compiled(compiled, matrix, gradient, at, diagonal)
    if diagonal is not None:
        matrix = matrix + torch.diag_embed(diagonal)
    free = ~(((at <= 0) & (gradient > 0)) | ((at >= 1) & (gradient < 0)))
    target = at + torch.where(free, _solve(matrix, torch.where(free, -gradient, 0.0), free), 0.0)
    step = target.clamp(0, 1) - at
    for _ in range(ROUNDS - 1):
        leaving = free & ((target < 0) | (target > 1))
        rows = leaving.any(dim=1).nonzero()[:, 0]
        if not len(rows):
            break
        free = free & ~leaving
        some, here = free[rows], matrix[rows]
        pinned = torch.where(some, 0.0, step[rows])
        rest = torch.where(some, -gradient[rows] - (here @ pinned[..., None])[..., 0], 0.0)
        target[rows] = at[rows] + torch.where(some, _solve(here, rest, some), pinned)
        step[rows] = target[rows].clamp(0, 1) - at[rows]
    return step


def _compiled(compiled: Kernels, matrix: Tensor, gradient: Tensor, at: Tensor, diagonal: Tensor | None) -> Tensor:
    meshes, controls = gradient.shape
    shared = matrix.stride(0) == 0 or meshes == 1
    matrix = matrix[0].contiguous() if shared else matrix.contiguous()
    step = torch.empty_like(gradient, memory_format=torch.contiguous_format)
    added = None if diagonal is None else diagonal.to(gradient).contiguous()
    given = (matrix, 0 if shared else controls * controls, added, gradient.contiguous(), at.contiguous(), step)
    compiled.call("box_step", gradient.dtype, *given, controls, ROUNDS, meshes)
    return step


def _solve(matrix: Tensor, right: Tensor, free: Tensor) -> Tensor:
    """Solve for the free controls alone, gathered into smaller systems; 0 for the others."""
    most = int(free.sum(dim=1).max())
    order = torch.argsort(free.to(torch.uint8), dim=1, descending=True, stable=True)[:, :most]
    some = free.gather(1, order)
    reduced = matrix.gather(1, order[:, :, None].expand(-1, -1, matrix.shape[2])).gather(2, order[:, None].expand(-1, most, -1))
    reduced.masked_fill_(~(some[:, :, None] & some[:, None]), 0.0)
    reduced.diagonal(dim1=1, dim2=2).add_(~some)
    wanted = torch.where(some, right.gather(1, order), 0.0)[..., None]
    factor, failed = torch.linalg.cholesky_ex(reduced)
    found = torch.cholesky_solve(wanted, factor)[..., 0]
    bad = (failed > 0).nonzero()[:, 0]
    if len(bad):
        exact, failed = torch.linalg.cholesky_ex(reduced[bad].double())
        again = torch.cholesky_solve(wanted[bad].double(), exact)[..., 0]
        found[bad] = torch.where((failed > 0)[:, None], 0.0, again).to(found)
    return torch.zeros_like(right).scatter_(1, order, found)
