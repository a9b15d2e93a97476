"""Rotations of DNA files: Euler angles of any sequence, and quaternions x y z w.

A sequence such as `xyz` gives the order of application: for column vectors R = Rz Ry Rx.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from rigs.dna.format import DnaFile
from rigs.dna.format.later_layers import Conventions
from rigs.dna.format.layers import Descriptor
from rigs.dna.logic.layout import Layout

SEQUENCES = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")
SIGNS = {1: 1.0, 0xFFFFFFFF: -1.0}
RADIANS = 1  # the descriptor's number for them; 0 is degrees
EPSILON = 1e-12


Sequence3 = tuple[int, int, int]


@dataclass(frozen=True)
class Angles:
    """Conventions of Euler angles.

    Attributes:
        sequence: indices of the axes in order of application.
        factors: radians per unit of the angle about x, y, z, with sign.
    """

    sequence: Sequence3
    factors: tuple[float, float, float]

    @classmethod
    def of(cls, file: DnaFile, layout: Layout) -> "Angles":
        """Conventions of a file; xyz and positive signs by default.

        Raises:
            InputError: they are invalid.
        """
        unit, conventions = file.need(Descriptor).rotation_unit, file.find(Conventions)
        sequence = conventions.sequence if conventions else 0
        signs = conventions.signs if conventions else None
        numbers = (signs.x, signs.y, signs.z) if signs else (1, 1, 1)
        if unit > RADIANS or sequence >= len(SEQUENCES) or any(number not in SIGNS for number in numbers):
            raise layout.wrong(f"rotations are of unit {unit}, sequence {sequence} and signs {numbers}, which are not known")
        factor = 1.0 if unit == RADIANS else np.pi / 180
        x, y, z = (SIGNS[number] * factor for number in numbers)
        return cls(axes_of(SEQUENCES[sequence]), (x, y, z))

    def radians(self, values: Tensor) -> Tensor:
        """Angles `(..., 3)` as the file has them, in radians, counter-clockwise."""
        return values * torch.tensor(self.factors, dtype=values.dtype, device=values.device)

    def in_file(self, radians: Tensor) -> Tensor:
        """The reverse of `radians`."""
        return radians / torch.tensor(self.factors, dtype=radians.dtype, device=radians.device)

    def matrices(self, values: Tensor, dim: int = -1) -> Tensor:
        """Angles as the file has them, x y z along `dim`, to rotation matrices, whose rows and columns take its place."""
        factors = torch.tensor(self.factors, dtype=values.dtype, device=values.device)
        shape = [1] * values.ndim
        shape[dim] = 3
        return euler_matrices(values * factors.view(shape), self.sequence, dim)

    def quaternions(self, values: Tensor) -> Tensor:
        """Angles `(..., 3)` as the file has them to quaternions `(..., 4)`."""
        return euler_quaternions(self.radians(values), self.sequence)


def axes_of(sequence: str) -> Sequence3:
    """Indices of the axes of a sequence such as `xyz`."""
    first, second, third = ("xyz".index(axis) for axis in sequence)
    return first, second, third


def euler_matrices(radians: Tensor, sequence: Sequence3, dim: int = -1) -> Tensor:
    """Angles about x, y, z, along `dim`, to rotation matrices, whose rows and columns take its place.

    Source: Shoemake, "Euler Angle Conversion", Graphics Gems IV, for static frames.
    """
    i, j, k = sequence
    parity = 1.0 if (j - i) % 3 == 1 else -1.0
    sines, cosines = torch.sin(parity * radians).unbind(dim), torch.cos(radians).unbind(dim)
    si, sj, sk, ci, cj, ck = (values[axis] for values in (sines, cosines) for axis in (i, j, k))
    cc, cs, sc, ss = ci * ck, ci * sk, si * ck, si * sk
    entries = {
        **{(i, i): cj * ck, (i, j): sj * sc - cs, (i, k): sj * cc + ss},
        **{(j, i): cj * sk, (j, j): sj * ss + cc, (j, k): sj * cs - sc},
        **{(k, i): -sj, (k, j): cj * si, (k, k): cj * ci},
    }
    rows = [entries[row, column] for row in range(3) for column in range(3)]
    axis_index = dim % radians.ndim
    return torch.stack(rows, dim=axis_index).unflatten(axis_index, (3, 3))


def euler_quaternions(radians: Tensor, sequence: Sequence3) -> Tensor:
    """Angles `(..., 3)` about x, y, z to quaternions `(..., 4)`."""
    half = radians / 2
    sines, cosines, axes = torch.sin(half), torch.cos(half), torch.eye(3, dtype=radians.dtype, device=radians.device)
    rotations = [
        torch.cat([axes[axis] * sines[..., axis : axis + 1], cosines[..., axis : axis + 1]], dim=-1) for axis in sequence
    ]
    return multiply(rotations[2], multiply(rotations[1], rotations[0]))


def matrix_angles(matrices: Tensor, sequence: Sequence3) -> Tensor:
    """Rotation matrices `(..., 3, 3)` to angles `(..., 3)` about x, y, z; in gimbal lock the last angle is 0."""
    i, j, k = sequence
    parity = 1.0 if (j - i) % 3 == 1 else -1.0
    cosine = torch.hypot(matrices[..., i, i], matrices[..., j, i])
    locked = cosine < 1e-6
    first = torch.where(
        locked,
        torch.atan2(-matrices[..., j, k], matrices[..., j, j]),
        torch.atan2(matrices[..., k, j], matrices[..., k, k]),
    )
    middle = torch.atan2(-matrices[..., k, i], cosine)
    last = torch.where(locked, 0.0, torch.atan2(matrices[..., j, i], matrices[..., i, i]))
    angles = torch.stack([first, middle, last], dim=-1) * parity
    return angles[..., [sequence.index(axis) for axis in range(3)]]


def quaternion_matrices(quaternions: Tensor) -> Tensor:
    """Unit quaternions `(..., 4)` to rotation matrices `(..., 3, 3)`."""
    x, y, z, w = quaternions.unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        *(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        *(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """The Hamilton product of quaternions `(..., 4)`: b rotates first."""
    ax, ay, az, aw = a.unbind(-1)
    bx, by, bz, bw = b.unbind(-1)
    parts = [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
    return torch.stack(parts, dim=-1)


def conjugate(quaternions: Tensor) -> Tensor:
    """The inverse of unit quaternions `(..., 4)`."""
    return quaternions * quaternions.new_tensor([-1.0, -1.0, -1.0, 1.0])


def normalise(quaternions: Tensor) -> Tensor:
    """Quaternions `(..., 4)` of length 1; the identity for length 0."""
    squares = quaternions.square().sum(dim=-1, keepdim=True)
    there = squares > EPSILON**2
    identity = quaternions.new_tensor([0.0, 0.0, 0.0, 1.0])
    return torch.where(there, quaternions / torch.where(there, squares, 1.0).sqrt(), identity)


def twist_of(quaternions: Tensor, axis: int) -> Tensor:
    """Twist `(..., 4)` of rotations about an axis; the swing is the rotation times the inverse of the twist."""
    kept = torch.zeros(4, dtype=quaternions.dtype, device=quaternions.device)
    kept[[axis, 3]] = 1.0
    return normalise(quaternions * kept)


def to_identity(quaternions: Tensor, weights: Tensor) -> Tensor:
    """Spherical interpolation from quaternions `(..., 4)` to the identity at weights `(...)`: the identity at 1."""
    quaternions = torch.where(quaternions[..., 3:] < 0, -quaternions, quaternions)
    vectors, scalars = quaternions[..., :3], quaternions[..., 3]
    squares = vectors.square().sum(dim=-1)
    there = squares > EPSILON**2
    lengths = torch.where(there, squares, 1.0).sqrt()
    half = torch.atan2(lengths, scalars)
    ratio = torch.where(there, torch.sin((1 - weights) * half) / lengths, (1 - weights) * torch.ones_like(lengths))
    last = torch.where(there, torch.cos((1 - weights) * half), torch.ones_like(lengths))
    return torch.cat([vectors * ratio[..., None], last[..., None]], dim=-1)
