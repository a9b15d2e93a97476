"""Avatars in glTF as rigs: morph targets, and on request joints, as controls."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.arkit import ArkitParts, arkit_deltas, arkit_parts
from riginv.rig.interface import Control, LinearRig
from rigs.gltf.avatar import read_avatar
from rigs.gltf.frames import frame_basis, joint_frames
from rigs.gltf.motion import ANGLES, AXES_IN_SPACE, JointMotion, by_axis, coefficient_names
from rigs.gltf.selection import mesh_names

SHOWN = 9  # targets that pictures show alone


class GltfRig(LinearRig):
    """An avatar from a .glb, .gltf or .vrm file.

    Args:
        file: the file.
        include: names or globs of the meshes, or their nodes, that make the rig; empty: all that can move.
        exclude: names or globs of those that do not.
        unit_mm: millimetres to a unit of the file: 1000, as glTF is in metres.
        weld: make one of the vertices that seams split.
        default_weights: whether the neutral controls are the weights that the file rests at; else 0.
        joints: whether the joints of its skins are controls too, three angles each, in degrees, about the joint's own axes:
            R = Rx Ry Rz after its rotation at rest.
        joint_include: globs of the joints that are; the others keep their places in their parents.
        joint_limit_deg: how far an angle may leave 0.

    Attributes:
        targets: the names of the morph targets.
        vertex_map: the rig's vertex of each of the file's, `(file vertex,)`: `vertices[:, vertex_map]` has the file's order.
        parts: for each run of file vertices the mesh and primitive they belong to, their first and one past their last.
        file, unit_mm: what was read, and millimetres to a unit of it.
        meshes: those that make the rig, in the order of their vertices.

    Raises:
        InputError: the file cannot be read or holds no rig; the message names the file, and what in it.
    """

    vertex_map: Tensor

    def __init__(
        self,
        file: str,
        include: Sequence[str] = (),
        exclude: Sequence[str] = (),
        unit_mm: float = 1000.0,
        weld: bool = False,
        default_weights: bool = False,
        joints: bool = False,
        joint_include: Sequence[str] = ("*",),
        joint_limit_deg: float = 60.0,
    ) -> None:
        for name, value in (("unit_mm", unit_mm), ("joint_limit_deg", joint_limit_deg)):
            if not (isinstance(value, int | float) and 0 < value < 1e6):
                raise InputError(f"rig.{name} is {value!r}, expected a number above 0")
        for name, value in (("include", include), ("exclude", exclude), ("joint_include", joint_include)):
            if isinstance(value, str):
                raise InputError(f"rig.{name} is {value!r}, expected a list of globs: rig.{name}=[{value!r}]")
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused by name
            avatar = read_avatar(str(file), list(include), list(exclude), unit_mm, weld, joints, default_weights)
            frames = joint_frames(avatar, list(joint_include)) if joints else None
            rows, pairs = frame_basis(avatar, frames) if frames else (None, None)
        rests = [avatar.defaults[name] for name in avatar.targets]
        controls = [Control(name, min(0.0, rest), max(1.0, rest), rest) for name, rest in zip(avatar.targets, rests)]
        names, basis, motion = list(avatar.targets), torch.tensor(avatar.deltas), None
        rest = torch.tensor(avatar.rest, dtype=torch.float32) + torch.einsum("k,kvc->vc", torch.tensor(rests), basis)
        if frames:
            limits = {"lower": -joint_limit_deg, "upper": joint_limit_deg, "unit": "deg"}
            controls += [Control(f"{joint}.{axis}", **limits) for joint in frames.names for axis in ANGLES]
            names = coefficient_names(frames, pairs, avatar.targets)
            basis, motion = torch.cat([by_axis(basis), rows]), JointMotion(frames, pairs)
        count = 0 if joints or any(rests) else len(controls)  # blendshape weights are 0 at rest
        super().__init__(avatar.file.path.stem, controls, rest, torch.tensor(avatar.faces), basis, names, count)
        self.targets, self.joint_motion = tuple(avatar.targets), motion
        self.parts = tuple((piece.label, piece.start, piece.start + piece.count) for piece in avatar.pieces)
        self.file, self.unit_mm, self.notes = avatar.file.path, float(unit_mm), tuple(avatar.file.notes)
        self.meshes = mesh_names(avatar.file, avatar.scene, [piece.node for piece in avatar.pieces])
        self.register_buffer("vertex_map", torch.tensor(avatar.vertex_map), persistent=False)

    def coefficients(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to the weights of the targets, which they are, and what the joints make of theirs."""
        if self.joint_motion is None:
            return controls
        return self.joint_motion(controls[:, : len(self.targets)], controls[:, len(self.targets) :])

    def arkit_parts(self) -> dict[str, ArkitParts]:
        return arkit_parts(self.targets)

    def arkit_deltas(self) -> dict[str, Tensor]:
        rows = 1 if self.joint_motion is None else AXES_IN_SPACE
        deltas = self.basis[: rows * len(self.targets)].unflatten(0, (-1, rows)).sum(dim=1)
        return arkit_deltas(self.arkit_parts(), dict(zip(self.targets, deltas)))

    def expressions(self) -> dict[str, dict[str, float]]:
        step = max(1, len(self.targets) // SHOWN)
        return {name: {name: 1.0} for name in self.targets[::step][:SHOWN]}
