"""Linear blend skinning (LBS).

The skinning matrix of a joint, 3x4, is its world transform times the inverse of that at rest. Vertices are linear in its 12
entries, so that a skinned rig ends in a linear map (`riginv.rig.interface.LinearRig`).
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.errors import InputError

NUMBERS = 12  # entries of one skinning matrix, row by row
SUM_TOLERANCE = 1e-3  # of the sum of a vertex's weights


def check_weights(weights: Float[Tensor, "vertex joint"], where: str, joint_names: Sequence[str] | None = None) -> None:
    """Check skin weights `(vertex, joint)`.

    Args:
        where: the source, such as a file, for the message.
        joint_names: for the message; None: their indices.

    Raises:
        InputError: a weight is not finite or negative, or those of a vertex do not sum to 1; the message names the vertex.
    """
    for wrong, what, want in (
        (~torch.isfinite(weights), "not finite", "finite numbers"),
        (weights < 0, "negative", "at least 0"),
    ):
        if wrong.any():
            vertex, joint = (int(index) for index in wrong.nonzero()[0])
            name = joint_names[joint] if joint_names else joint
            raise InputError(
                f"{where}: the skin weight of vertex {vertex} for joint '{name}' is {what} "
                f"({float(weights[vertex, joint]):g}), expected {want}: correct the weights and export again"
            )
    sums = weights.sum(dim=1)
    off = (sums - 1).abs() > SUM_TOLERANCE
    if off.any():
        vertex = int(off.nonzero()[0, 0])
        raise InputError(
            f"{where}: the skin weights of {int(off.sum())} vertices do not sum to 1, the first is vertex {vertex} with "
            f"{float(sums[vertex]):g}: normalise the weights and export again"
        )


def skinning_basis(
    rest_vertices: Float[Tensor, "vertex 3"],
    weights: Float[Tensor, "vertex joint"],
    centres: Float[Tensor, "joint 3"] | None = None,
) -> Float[Tensor, "coefficient vertex 3"]:
    """The basis of LBS as a linear map of the entries of the skinning matrices.

    Args:
        rest_vertices: in mm.
        weights: each row summing to 1.
        centres: the origin of each joint's matrix, such as its position at rest: the matrix then maps
            rest - centre, and its translation is the centre's new position. None: the world's origin.

    Returns:
        `(12 * joint, vertex, 3)`: matrices flattened to `(batch, 12 * joint)`, times this, are the vertices.
    """
    vertices, joints = weights.shape
    offsets = rest_vertices[None] - (0 if centres is None else centres[:, None])
    points = torch.cat([offsets.expand(joints, vertices, 3), offsets.new_ones(joints, vertices, 1)], dim=2)
    return matrix_basis(weights.T[..., None] * points)


def matrix_basis(points: Float[Tensor, "item vertex column"]) -> Float[Tensor, "coefficient vertex 3"]:
    """The basis of matrices `(3, column)`, one for each item, that act on its points; their entries row by row."""
    items, vertices, columns = points.shape
    basis = points.new_zeros(items, 3, columns, vertices, 3)
    for axis in range(3):
        basis[:, axis, :, :, axis] = points.transpose(1, 2)
    return basis.reshape(items * 3 * columns, vertices, 3)


def by_axis(deltas: Float[Tensor, "target vertex 3"]) -> Float[Tensor, "row vertex 3"]:
    """Deltas as three rows each, one for every axis of space."""
    return (deltas[:, None] * torch.eye(3, dtype=deltas.dtype, device=deltas.device)[:, None]).flatten(0, 1)


def skin(
    rest_vertices: Float[Tensor, "vertex 3"], weights: Float[Tensor, "vertex joint"], matrices: Float[Tensor, "batch joint 3 4"]
) -> Float[Tensor, "batch vertex 3"]:
    """LBS of a mesh, without a basis.

    Args:
        rest_vertices: in mm.
        matrices: skinning matrices.
    """
    blended = torch.einsum("vj,bjrc->bvrc", weights, matrices)
    return (blended[..., :3] @ rest_vertices[..., None]).squeeze(-1) + blended[..., 3]
