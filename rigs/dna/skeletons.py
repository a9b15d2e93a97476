"""Skeletons of DNA rigs that are purely skinned, for BVH, glTF and USD."""

import numpy as np
import torch
from torch import Tensor, nn

from riginv.geometry.kinematics import Skeleton, bone_tails
from rigs.dna.linear import SCALES, rows_of
from rigs.dna.model import Model

MOST = 100_000_000  # weights of all vertices for all joints


def skeleton_of(model: Model, mapping: nn.Module, names: tuple[str, ...]) -> Skeleton | None:
    """The skeleton of a model; None with blendshapes, scaling joints, several roots or unskinned vertices.

    Args:
        mapping: from controls to raw controls.
        names: of all joints of the file.
    """
    skeleton, groups = model.skeleton, model.logic.joints.groups
    if len(model.channels) or sum(parent < 0 for parent in skeleton.parents) != 1 or np.prod(model.skin.weights.shape) > MOST:
        return None
    weights = model.skin.weights.toarray()
    if weights[:, -1].any():
        return None
    attributes = groups.rows_of_attributes.view(len(model.joints), -1)
    chosen = [names[joint] for joint in model.joints]
    if (
        (attributes[:, SCALES] < rows_of(model)).any()
        or model.logic.joints.learned is not None
        or len(set(chosen)) < len(chosen)
    ):
        return None
    order = torch.cat(skeleton.levels)  # parents before their children
    new = {int(joint): number for number, joint in enumerate(order)}
    parents = tuple(new.get(skeleton.parents[int(joint)], -1) for joint in order)
    centre = model.centre
    heads = skeleton.neutral[order, :, 3]

    def pose(controls: Tensor) -> Tensor:
        matrices = model.pose(mapping(controls)).matrices.index_select(0, order).movedim(-1, 0)
        linear = matrices[..., :3]
        posed = linear @ heads.to(linear)[..., None] + matrices[..., 3:] + centre.to(linear)[:, None]
        return torch.cat([linear, posed], dim=-1)

    return Skeleton(
        joint_names=tuple(chosen[int(joint)] for joint in order),
        parents=parents,
        heads=(heads + centre).float(),
        tails=bone_tails(heads + centre, parents).float(),
        weights=torch.tensor(weights[:, order], dtype=torch.float32),
        pose=pose,
    )
