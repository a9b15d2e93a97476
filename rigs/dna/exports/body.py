"""The default body as a draft of a DNA file."""

import numpy as np
from scipy import sparse

from rigs.body import BodyRig
from rigs.body.controls import MOVES
from rigs.dna.draft import Draft, MeshDraft
from rigs.dna.exports.blendshapes import triangles
from rigs.dna.exports.joints import JointDrive, add_joints

SEQUENCE = "yzx"  # R = Rx Rz Ry in each joint's frame
ATTRIBUTE = (3, 5, 4)  # of a joint's first, middle and last axis, which are x, z, y of its frame


def draft_of_body(rig: BodyRig) -> Draft:
    """The body: its joints in their own frames, and every control on the joints that it drives."""
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
