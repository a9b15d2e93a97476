"""Driven joints in the terms of the format: two raw controls for each control, one on each side of 0."""

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from scipy import sparse

from riginv.rig.interface import Control
from rigs.body import BodyRig
from rigs.body.controls import MOVES
from rigs.dna.draft import Draft, Group, Joint, MeshDraft, Row
from rigs.dna.exports.blendshapes import triangles
from rigs.dna.logic.rotations import SEQUENCES, axes_of, matrix_angles

UP, DOWN = "+", "-"  # suffixes of the raw controls on either side of 0


class JointDrive(NamedTuple):
    """Contribution of a control to an attribute of a joint per unit: mm or degrees.

    Attributes:
        attribute: 0 to 2 translation, 3 to 5 rotation by x, y, z.
    """

    control: str
    joint: int
    attribute: int
    amount: float


def add_joints(
    draft: Draft,
    controls: Sequence[Control],
    drives: Sequence[JointDrive],
    names: Sequence[str],
    parents: Sequence[int],
    rest: np.ndarray,
) -> None:
    """Add joints and the controls that drive them to a draft.

    Args:
        controls: those of `drives`; each is 0 at rest.
        parents: -1 for a root.
        rest: world transforms of the joints at rest, `(joint, 3, 4)`, mm, their rotations orthogonal.
    """
    of_control = {control.name: control for control in controls}
    index_of: dict[str, int] = {}
    for control in controls:
        draft.gui.append(control.name)
        for ending, limit in ((UP, control.upper), (DOWN, control.lower)):
            if limit:
                raw = control.name + ending
                index_of[raw] = len(draft.raw)
                draft.raw.append(raw)
                points = sorted([(0.0, 0.0), (limit, 1.0)])
                draft.rows.append(Row.between(control.name, raw, *points))
    assert draft.sequence in SEQUENCES
    first = len(draft.joints)
    for number, (name, parent) in enumerate(zip(names, parents)):
        linear, position = rest[number, :, :3], rest[number, :, 3]
        if parent >= 0:
            above = rest[parent, :, :3]
            linear, position = above.T @ linear, above.T @ (position - rest[parent, :, 3])
        angles = np.degrees(matrix_angles(torch.tensor(linear), axes_of(draft.sequence)).numpy())
        draft.joints.append(Joint(name, -1 if parent < 0 else first + parent, position.tolist(), angles.tolist()))
    entries: dict[int, dict[tuple[int, int], float]] = defaultdict(lambda: defaultdict(float))
    for drive in drives:
        for ending, limit in ((UP, of_control[drive.control].upper), (DOWN, of_control[drive.control].lower)):
            if limit:
                key = (9 * (first + drive.joint) + drive.attribute, index_of[drive.control + ending])
                entries[drive.joint][key] += drive.amount * limit
    for values in entries.values():
        draft.groups.append(_group(values))


def _group(values: dict[tuple[int, int], float]) -> Group:
    """A group from the values at (attribute, control)."""
    attributes, columns = (sorted({key[part] for key in values}) for part in (0, 1))
    matrix = np.zeros((len(attributes), len(columns)))
    for (attribute, column), value in values.items():
        matrix[attributes.index(attribute), columns.index(column)] = value
    return Group(columns, attributes, matrix)


SEQUENCE = "yzx"  # R = Rx Rz Ry in each joint's frame
ATTRIBUTE = (3, 5, 4)  # of a joint's first, middle and last axis, which are x, z, y of its frame


def draft_of_body(rig: BodyRig) -> Draft:
    """A draft of the default body: joints in their own frames, and the joint axes that each control drives."""
    skeleton = rig.skeleton()
    heads, frames = skeleton.heads.double().numpy(force=True), rig.frames.double().numpy(force=True)
    rest = np.concatenate([frames, heads[..., None]], axis=2)
    degrees = rig.angles.rad2deg().double().numpy(force=True)
    drives = [
        JointDrive(rig.control_names[control], number // 3, ATTRIBUTE[number % 3], float(degrees[control, number]))
        for control, number in zip(*degrees.nonzero())
    ]
    drives += [JointDrive(name, skeleton.parents.index(-1), axis, 1.0) for axis, name in enumerate(MOVES)]
    draft = Draft(rig.name, sequence=SEQUENCE)
    add_joints(draft, rig.controls, drives, skeleton.joint_names, skeleton.parents, rest)
    weights = sparse.csr_array(skeleton.weights.double().numpy(force=True))
    faces = triangles(rig.faces.numpy(force=True))
    draft.meshes = [MeshDraft(rig.name, rig.rest_vertices.double().numpy(force=True), faces, weights, {})]
    return draft
