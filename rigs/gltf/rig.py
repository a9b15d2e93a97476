"""glTF avatars as rigs, with morph targets and optionally joints as controls."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.geometry.euler import continuous_angles
from riginv.geometry.kinematics import Skeleton, bone_tails, transform_from
from riginv.geometry.skinning import SUM_TOLERANCE, by_axis
from riginv.rig.arkit import ArkitParts, arkit_deltas, arkit_parts
from riginv.rig.interface import Control, LinearRig
from riginv.rig.jacobian import Jacobian
from riginv.rig.joint_features import JointFeatures, SkinFeatures
from rigs.gltf.avatar import Avatar, read_avatar
from rigs.gltf.frames import Frames, frame_basis, frame_weights, joint_frames
from rigs.gltf.joint_controls import Choice, Drives, joint_drives
from rigs.gltf.motion import AXES, JointMotion, coefficient_names
from rigs.gltf.node_motion import node_motions
from rigs.gltf.selection import mesh_names

STILL = 1e-5  # of the mesh's size: smaller translations of a joint are none
METRE = 1000.0  # mm: the size of a skinned mesh for which the solvers' lengths are meant
LEAST_WEIGHT = 0.25  # greatest skin weight of a joint: with less it has no vertices that show its rotation
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
            R = Rx Ry Rz after its rest rotation, or another order (`joint_orders`).
        joint_include: globs of the controlled joints; the others are fixed to their parents.
        joint_limit_deg: range of the angles on either side of 0, in the order Rx Ry Rz; `auto`: the range of the file's
            animations, 60 at least, in the order of rotation that keeps them farthest from gimbal lock.
        joint_translation: whether joints have translations, mm along their parents' axes; `auto`: those that an animation of
            the file translates, and the roots of an animated skeleton.
        joint_scale: whether joints have scales; `auto`: those that an animation scales.

    Attributes:
        targets: names of the morph targets.
        vertex_map: index of the rig's vertex for each of the file's, `(file vertex,)`: `vertices[:, vertex_map]` has the
            file's order.
        parts: for each submesh its label, its first vertex and one past its last.
        file, unit_mm: path of the file, and millimetres per unit.
        meshes: names of the meshes of the rig, in the order of their vertices.
        joint_orders: order of rotation of each controlled joint by name, as `XYZ`.

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
        joint_limit_deg: float | Literal["auto"] = "auto",
        joint_translation: Choice = "auto",
        joint_scale: Choice = "auto",
    ) -> None:
        for name, value in (("unit_mm", unit_mm), ("joint_limit_deg", joint_limit_deg)):
            auto = name == "joint_limit_deg" and value == "auto"
            if not auto and (isinstance(value, bool) or not (isinstance(value, int | float) and 0 < value < 1e6)):
                expected = "a number above 0" + ", or auto" * (name == "joint_limit_deg")
                raise InputError(f"rig.{name} is {value!r}, expected {expected}")
        for name, choice in (("joint_translation", joint_translation), ("joint_scale", joint_scale)):
            if choice != "auto" and not isinstance(choice, bool):
                raise InputError(f"rig.{name} is {choice!r}, expected auto, true or false")
        for name, globs in (("include", include), ("exclude", exclude), ("joint_include", joint_include)):
            if isinstance(globs, str):
                raise InputError(f"rig.{name} is {globs!r}, expected a list of globs: rig.{name}=[{globs!r}]")
        with np.errstate(over="ignore", invalid="ignore"):  # overflow is refused by `check_distances`
            avatar = read_avatar(str(file), list(include), list(exclude), unit_mm, weld, joints, default_weights)
            limit = None if joint_limit_deg == "auto" else float(joint_limit_deg)
            setup = _joints(avatar, list(joint_include), limit, joint_translation, joint_scale) if joints else None
        defaults = [avatar.defaults[name] for name in avatar.targets]
        controls = [Control(name, min(0.0, value), max(1.0, value), value) for name, value in zip(avatar.targets, defaults)]
        names, basis, motion = list(avatar.targets), torch.tensor(avatar.deltas), None
        rest = torch.tensor(avatar.rest, dtype=torch.float32) + torch.einsum("k,kvc->vc", torch.tensor(defaults), basis)
        orders: dict[str, str] = {}
        if setup:
            frames, drives = setup
            with np.errstate(over="ignore", invalid="ignore"):
                rows, pairs = frame_basis(avatar, frames)
            controls += drives.controls
            names = coefficient_names(frames, pairs, avatar.targets)
            basis, motion = torch.cat([by_axis(basis), rows]), JointMotion(frames, drives, pairs)
            orders = {name: "".join("XYZ"[a] for a in order) for name, order in zip(frames.names, drives.orders.tolist())}
        count = 0 if joints or any(defaults) else len(controls)  # blendshape weights are 0 at rest
        super().__init__(avatar.file.path.stem, controls, rest, torch.tensor(avatar.faces), basis, names, count)
        self.targets, self.joint_motion, self.joint_orders = tuple(avatar.targets), motion, orders
        self.skin_features: SkinFeatures | None = None
        if motion is not None:
            size = float((rest.amax(dim=0) - rest.amin(dim=0)).max().clamp_min(1e-6))
            self.length_scale = size / METRE
            weights = frame_weights(self.basis, AXES * len(self.targets), motion.count)
            weight = torch.where(weights.amax(dim=1) < LEAST_WEIGHT, 0.0, weights.sum(dim=1))
            features = JointFeatures(motion.freedom, weight, size)
            self.skin_features = SkinFeatures(features, torch.arange(motion.count), len(self.targets), motion.pairs)
        self.has_first_guess = motion is not None and not self.targets
        self.parts = tuple((submesh.label, submesh.start, submesh.start + submesh.count) for submesh in avatar.submeshes)
        self.file, self.unit_mm, self.notes = avatar.file.path, float(unit_mm), tuple(avatar.file.notes)
        self.meshes = mesh_names(avatar.file, avatar.scene, [submesh.node for submesh in avatar.submeshes])
        self.register_buffer("vertex_map", torch.tensor(avatar.vertex_map), persistent=False)

    def coefficients(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to morph weights, or with joints to the coefficients of `JointMotion`."""
        if self.joint_motion is None:
            return controls
        return self.joint_motion(controls[:, : len(self.targets)], controls[:, len(self.targets) :])

    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        """As `coefficients`, with the Jacobian of kinematics and skinning in closed form."""
        if self.joint_motion is None:
            return super().coefficient_jacobian(controls)
        return self.joint_motion.with_jacobian(controls[:, : len(self.targets)], controls[:, len(self.targets) :])

    def skeleton(self) -> Skeleton | None:
        """The controlled joints; None with morph targets or scales, several roots, or vertices that no joint moves."""
        motion, roots = self.joint_motion, [] if self.joint_motion is None else [p for p in self.joint_motion.parents if p < 0]
        if motion is None or self.targets or len(motion.scaled) or len(roots) != 1:
            return None
        weights, heads = frame_weights(self.basis, 0, motion.count).T, motion.rest[..., 3]
        if (weights.sum(dim=1) - 1).abs().max() > SUM_TOLERANCE:
            return None

        def pose(controls: Tensor) -> Tensor:
            worlds = motion.worlds(motion.local(controls))
            return transform_from(worlds[..., :3], (worlds[..., :3] @ heads.to(worlds)[..., None])[..., 0] + worlds[..., 3])

        parents = tuple(motion.parents)
        return Skeleton(tuple(self.joint_orders), parents, heads, bone_tails(heads, parents), weights, pose)

    def features(self, coefficients: Tensor) -> Tensor | None:
        """Weights of targets, and the rotation, translation and scale of each joint relative to its parent."""
        return None if self.skin_features is None else self.skin_features(coefficients)

    def feature_change(self, before: Tensor, after: Tensor) -> Tensor:
        return after - before if self.skin_features is None else self.skin_features.change(before, after)

    def guess_from_features(self, features: Tensor) -> Tensor | None:
        if self.joint_motion is None or self.skin_features is None:
            return None
        weights, of_joints = features.tensor_split((len(self.targets),), dim=1)
        angles = slice(len(self.targets), len(self.targets) + 3 * self.joint_motion.count)
        limits = (torch.deg2rad(one[angles].unflatten(0, (-1, 3))).to(features) for one in (self.lower, self.upper))
        return torch.cat([weights, self.skin_features.joints.controls(of_joints, *limits)], dim=1)

    @torch.no_grad()
    def continuous(self, controls: Tensor) -> Tensor:
        if self.joint_motion is None:
            return controls
        first, count = len(self.targets), 3 * self.joint_motion.count
        rows = slice(first, first + count)
        angles, *limits = (torch.deg2rad(one[..., rows]).unflatten(-1, (-1, 3)) for one in (controls, self.lower, self.upper))
        found = torch.rad2deg(continuous_angles(angles, self.joint_motion.orders, *limits)).flatten(1)
        return torch.cat([controls[:, :first], found, controls[:, first + count :]], dim=1)

    def arkit_parts(self) -> dict[str, ArkitParts]:
        return arkit_parts(self.targets)

    def arkit_deltas(self) -> dict[str, Tensor]:
        rows = 1 if self.joint_motion is None else AXES
        deltas = self.basis[: rows * len(self.targets)].unflatten(0, (-1, rows)).sum(dim=1)
        return arkit_deltas(self.arkit_parts(), dict(zip(self.targets, deltas)))

    def expressions(self) -> dict[str, dict[str, float]]:
        step = max(1, len(self.targets) // SHOWN)
        return {name: {name: 1.0} for name in self.targets[::step][:SHOWN]}


def _joints(
    avatar: Avatar, include: list[str], limit_deg: float | None, translation: Choice, scale: Choice
) -> tuple[Frames, Drives]:
    """The controlled joints of an avatar, and what their controls do."""
    size = float(np.linalg.norm(np.ptp(avatar.rest, axis=0)))
    motions = node_motions(avatar.file, avatar.scene, STILL * size / avatar.mm)
    frames = joint_frames(avatar, include, motions)
    return frames, joint_drives(avatar, frames, motions, limit_deg, translation, scale)
