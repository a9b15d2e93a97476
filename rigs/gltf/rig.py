"""glTF avatars as rigs, with morph targets and optionally joints as controls."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.geometry.skinning import by_axis
from riginv.rig.arkit import ArkitParts, arkit_deltas, arkit_parts
from riginv.rig.interface import Control, LinearRig
from rigs.gltf.avatar import read_avatar
from rigs.gltf.frames import frame_basis, joint_frames
from rigs.gltf.motion import ANGLES, AXES, JointMotion, coefficient_names
from rigs.gltf.selection import mesh_names

SHOWN = 9  # targets shown as expressions


class GltfRig(LinearRig):
    """An avatar from a .glb, .gltf or .vrm file.

    Args:
        file: the file.
        include: names or globs of the meshes, or their nodes, of the rig; empty: all that are deformable.
        exclude: names or globs of meshes to leave out.
        unit_mm: millimetres per unit of the file; 1000 by the glTF specification.
        weld: merge vertices that seams have split.
        default_weights: use the file's default weights as neutral controls; else 0.
        joints: add the joints of the skins as controls, three angles each, degrees, about the joint's own axes:
            R = Rx Ry Rz after its rest rotation.
        joint_include: globs of the controlled joints; the others are fixed to their parents.
        joint_limit_deg: range of the angles on either side of 0.

    Attributes:
        targets: names of the morph targets.
        vertex_map: index of the rig's vertex for each of the file's, `(file vertex,)`: `vertices[:, vertex_map]` has the
            file's order.
        parts: for each submesh its label, its first vertex and one past its last.
        file, unit_mm: path of the file, and millimetres per unit.
        meshes: names of the meshes of the rig, in the order of their vertices.

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
        for name, globs in (("include", include), ("exclude", exclude), ("joint_include", joint_include)):
            if isinstance(globs, str):
                raise InputError(f"rig.{name} is {globs!r}, expected a list of globs: rig.{name}=[{globs!r}]")
        with np.errstate(over="ignore", invalid="ignore"):  # overflow is refused by `check_distances`
            avatar = read_avatar(str(file), list(include), list(exclude), unit_mm, weld, joints, default_weights)
            frames = joint_frames(avatar, list(joint_include)) if joints else None
        defaults = [avatar.defaults[name] for name in avatar.targets]
        controls = [Control(name, min(0.0, value), max(1.0, value), value) for name, value in zip(avatar.targets, defaults)]
        names, basis, motion = list(avatar.targets), torch.tensor(avatar.deltas), None
        rest = torch.tensor(avatar.rest, dtype=torch.float32) + torch.einsum("k,kvc->vc", torch.tensor(defaults), basis)
        if frames:
            with np.errstate(over="ignore", invalid="ignore"):
                rows, pairs = frame_basis(avatar, frames)
            names_of_angles = [f"{joint}.{axis}" for joint in frames.names for axis in ANGLES]
            controls += [Control(name, -joint_limit_deg, joint_limit_deg, unit="deg") for name in names_of_angles]
            names = coefficient_names(frames, pairs, avatar.targets)
            basis, motion = torch.cat([by_axis(basis), rows]), JointMotion(frames, pairs)
        count = 0 if joints or any(defaults) else len(controls)  # blendshape weights are 0 at rest
        super().__init__(avatar.file.path.stem, controls, rest, torch.tensor(avatar.faces), basis, names, count)
        self.targets, self.joint_motion = tuple(avatar.targets), motion
        self.parts = tuple((submesh.label, submesh.start, submesh.start + submesh.count) for submesh in avatar.submeshes)
        self.file, self.unit_mm, self.notes = avatar.file.path, float(unit_mm), tuple(avatar.file.notes)
        self.meshes = mesh_names(avatar.file, avatar.scene, [submesh.node for submesh in avatar.submeshes])
        self.register_buffer("vertex_map", torch.tensor(avatar.vertex_map), persistent=False)

    def coefficients(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to morph weights, or with joints to the coefficients of `JointMotion`."""
        if self.joint_motion is None:
            return controls
        return self.joint_motion(controls[:, : len(self.targets)], controls[:, len(self.targets) :])

    def arkit_parts(self) -> dict[str, ArkitParts]:
        return arkit_parts(self.targets)

    def arkit_deltas(self) -> dict[str, Tensor]:
        rows = 1 if self.joint_motion is None else AXES
        deltas = self.basis[: rows * len(self.targets)].unflatten(0, (-1, rows)).sum(dim=1)
        return arkit_deltas(self.arkit_parts(), dict(zip(self.targets, deltas)))

    def expressions(self) -> dict[str, dict[str, float]]:
        step = max(1, len(self.targets) // SHOWN)
        return {name: {name: 1.0} for name in self.targets[::step][:SHOWN]}
