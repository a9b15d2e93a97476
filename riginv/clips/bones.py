"""Clips given as the motion of a skeleton: the meshes are those of a rig whose joints of the same names follow it."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import roma
import torch
from torch import Tensor

from riginv.clips.sequence import MeshSequence, Polygons, SourceFacts
from riginv.clips.units import TO_Y_UP
from riginv.errors import InputError, listed
from riginv.geometry.kinematics import tree_levels
from riginv.geometry.skinning import skin
from riginv.rig.interface import RigBackend

FEWEST = 0.5  # of the joints of the rig or of the file, whichever are fewer, must be found by name
STRAIGHT = 0.9999  # cosine of an angle between bones at rest that counts as none


class JointNamesError(InputError):
    """Too few joints of a file have the name of a joint of the rig."""


class BoneMotion(NamedTuple):
    """The motion of a skeleton.

    Attributes:
        names: of the joints; parents come before their children.
        parents: index of each joint's parent, -1 for a root.
        heads: positions at rest, `(joint, 3)`, in the file's unit.
        rotations: of each joint in world space, relative to rest, `(frame, joint, 3, 3)`.
        positions: of each joint in world space, `(frame, joint, 3)`.
        fps: frames a second.
        frame_numbers: `(frame,)`, rising; None: from 0.
        up: the axis of the file that is up.
        unit_mm: millimetres per unit, where the file states it.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    heads: Tensor
    rotations: Tensor
    positions: Tensor
    fps: float | None
    frame_numbers: np.ndarray | None = None
    up: str = "y"
    unit_mm: float | None = None

    def y_up(self) -> "BoneMotion":
        """The same motion with y up."""
        turn = TO_Y_UP[self.up].to(self.heads)
        heads, rotations, positions = self.heads @ turn.mT, turn @ self.rotations @ turn.mT, self.positions @ turn.mT
        return self._replace(heads=heads, rotations=rotations, positions=positions, up="y")


def motion_of_worlds(
    names: Sequence[str], parents: Sequence[int], rest: Tensor, worlds: Tensor, fps: float | None
) -> BoneMotion:
    """The motion of a skeleton from world transforms of its joints.

    Args:
        rest: `(joint, 3, 4)`.
        worlds: `(frame, joint, 3, 4)`.
    """
    rotations = roma.special_procrustes(worlds[..., :3]) @ roma.special_procrustes(rest[..., :3]).mT
    return BoneMotion(tuple(names), tuple(parents), rest[..., 3], rotations, worlds[..., 3], fps)


class BonesClip(MeshSequence):
    """The meshes of a rig whose joints rotate as those of the same names in a file.

    Rotations are taken over in world space; where the bones of the two skeletons point elsewhere at rest, as in a T-pose and an
    A-pose, those of the rig are first brought to the file's. Proportions stay the rig's: the path of the topmost joint is
    scaled by the length of the bones. Joints without a namesake keep their rotation relative to their parent.

    Args:
        facts: on the file.

    Raises:
        InputError: the rig has no skeleton, or too few of the names match.
    """

    def __init__(self, path: str, motion: BoneMotion, rig: RigBackend, facts: SourceFacts) -> None:
        skeleton = rig.skeleton()
        if skeleton is None:
            raise InputError(
                f"{path}: the motion of a skeleton needs a rig with one, and rig '{rig.name}' has none that is only skinned: "
                f"give a clip of meshes"
            )
        self.skeleton, self.motion, self.axes = skeleton, motion.y_up(), TO_Y_UP[motion.up].double()
        self.source = match_names(skeleton.joint_names, motion.names, path, rig.name)
        self.rest_vertices, self.levels = rig.rest_vertices.cpu().double(), tree_levels(skeleton.parents)
        self.scale, notes = self._scale(), list(facts.notes)
        self.to_rest = self._to_rest()
        bent = int(((self.to_rest - torch.eye(3)).abs().amax(dim=(1, 2)) > 1e-6).sum())
        missing = [name for name, source in zip(skeleton.joint_names, self.source) if source < 0]
        known = {name for number, name in enumerate(motion.names) if number in self.source}
        notes.append(f"The motion of {len(known)} joints, found by name, moves the joints of rig '{rig.name}'.")
        if missing:
            notes.append(f"Joints of the rig that it does not name keep their place on their parents: {listed(missing)}.")
        if left := [name for name in motion.names if name not in known]:
            notes.append(f"Joints that the rig does not have were left out: {listed(left)}.")
        stated = f"; the file states {motion.unit_mm:.4g} mm" if motion.unit_mm else ""
        notes.append(f"A unit of its skeleton is {self.scale:.4g} mm of the rig's, by the lengths of the bones{stated}.")
        if bent:
            notes.append(f"{bent} bones point elsewhere at rest than the rig's, whose pose at rest was adapted.")
        facts = replace(facts, notes=tuple(notes))
        faces = Polygons.triangles(rig.faces.cpu().numpy())
        frames = np.arange(len(motion.rotations)) if motion.frame_numbers is None else motion.frame_numbers
        super().__init__(path, frames, len(self.rest_vertices), faces, motion.fps, 1.0, motion.up, facts)

    @torch.no_grad()
    def read(self, start: int, stop: int) -> np.ndarray:
        matrices = self.joint_transforms(start, stop)
        matrices[..., 3] -= (matrices[..., :3] @ self.skeleton.heads.double()[..., None])[..., 0]
        return (skin(self.rest_vertices, self.skeleton.weights.double(), matrices) @ self.axes).float().numpy()

    def joint_transforms(self, start: int, stop: int) -> Tensor:
        """World transforms `(frame, joint, 3, 4)` of the rig's joints, mm."""
        heads, parents, source = self.skeleton.heads.double(), self.skeleton.parents, self.source
        rotations, positions = self.motion.rotations[start:stop], self.motion.positions[start:stop]
        worlds = torch.eye(4, dtype=torch.float64)[:3].repeat(len(rotations), len(heads), 1, 1)
        top = next(joint for joint in torch.cat(self.levels).tolist() if source[joint] >= 0)
        for joint in torch.cat(self.levels).tolist():
            parent = parents[joint]
            if source[joint] >= 0:
                worlds[:, joint, :, :3] = rotations[:, source[joint]] @ self.to_rest[joint]
            elif parent >= 0:
                worlds[:, joint, :, :3] = worlds[:, parent, :, :3]
            if parent >= 0:
                bone = worlds[:, parent, :, :3] @ (heads[joint] - heads[parent])
                worlds[:, joint, :, 3] = worlds[:, parent, :, 3] + bone
        shift = self.scale * positions[:, source[top]] - worlds[:, top, :, 3]
        worlds[..., 3] += shift[:, None]
        return worlds

    def _bones(self) -> list[tuple[int, int]]:
        """Joints of the rig and their nearest ancestors, both with namesakes."""
        found = []
        for joint, parent in enumerate(self.skeleton.parents):
            while parent >= 0 and self.source[parent] < 0:
                parent = self.skeleton.parents[parent]
            if parent >= 0 and self.source[joint] >= 0:
                found.append((parent, joint))
        return found

    def _scale(self) -> float:
        """Millimetres to a unit of the file, from the lengths of the bones."""
        heads, theirs = self.skeleton.heads.double(), self.motion.heads[self.source]
        ours, of_file = (sum(float((x[b] - x[a]).norm()) for a, b in self._bones()) for x in (heads, theirs))
        return ours / of_file if of_file > 0 else 1.0

    def _to_rest(self) -> Tensor:
        """Rotations `(joint, 3, 3)` that bring the rig's bones at rest to where the file's point."""
        heads, theirs = self.skeleton.heads.double(), self.motion.heads[self.source]
        found = torch.eye(3, dtype=torch.float64).repeat(len(heads), 1, 1)
        below: dict[int, list[tuple[Tensor, Tensor]]] = {}
        for parent, joint in self._bones():
            pair = heads[joint] - heads[parent], theirs[joint] - theirs[parent]
            if min(float(one.norm()) for one in pair) > 0:
                below.setdefault(parent, []).append((pair[0] / pair[0].norm(), pair[1] / pair[1].norm()))
        for joint in torch.cat(self.levels).tolist():
            pairs, parent = below.get(joint, []), self.skeleton.parents[joint]
            if pairs and min(float(ours @ other) for ours, other in pairs) > STRAIGHT:
                continue
            if len(pairs) == 1:
                found[joint] = _shortest(*pairs[0])
            elif pairs:
                found[joint] = roma.special_procrustes(sum(other[:, None] * ours for ours, other in pairs))
            elif parent >= 0:
                found[joint] = found[parent]
        return found


def _shortest(before: Tensor, after: Tensor) -> Tensor:
    """The smallest rotation between unit vectors `(3,)`."""
    axis, cosine = torch.linalg.cross(before, after), float(before @ after)
    if cosine < -STRAIGHT:
        other = torch.linalg.cross(before, torch.eye(3, dtype=before.dtype)[int(before.abs().argmin())])
        return roma.rotvec_to_rotmat(torch.pi * other / other.norm())
    return roma.rotvec_to_rotmat(axis / axis.norm().clamp_min(1e-12) * float(np.arccos(min(cosine, 1.0))))


def match_names(ours: Sequence[str], theirs: Sequence[str], path: str, rig: str) -> list[int]:
    """For each joint of a rig the index of its namesake in a file, -1: none.

    Namespaces (`mixamorig:Hips`), a prefix of all names (`mixamorig_Hips`), capitals, and signs between words do not count.

    Raises:
        JointNamesError: too few are found.
    """
    exact = {name: number for number, name in reversed(list(enumerate(theirs)))}
    plain = {_plain(name): number for number, name in reversed(list(enumerate(theirs)))}
    prefixed = len(theirs) > 1 and len({name.partition("_")[0] for name in theirs}) == 1
    bare = {_plain(name.partition("_")[2]): number for number, name in reversed(list(enumerate(theirs))) if prefixed}
    found = [exact.get(name, plain.get(_plain(name), bare.get(_plain(name), -1))) for name in ours]
    count = len({number for number in found if number >= 0})
    if count < max(1, FEWEST * min(len(ours), len(theirs))):
        raise JointNamesError(
            f"{path}: {count} of its {len(theirs)} joints ({listed(theirs, 4)}) have the name of a joint of rig '{rig}' "
            f"({listed(ours, 4)}), expected at least half: rename them"
        )
    return found


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name.rpartition(":")[2].rpartition("|")[2]).lower()
