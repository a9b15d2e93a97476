"""Blueprint of the default body."""

import numpy as np
import torch

from rigs.blender.blueprint import Blueprint, Channel, Skeleton, Value
from rigs.body import BodyRig
from rigs.body.build import body_geometry
from rigs.body.controls import MOVES

BLENDER_ORDER = "YZX"  # `rigs.body.rig.ORDER` as Blender names it, by the order of application
COLUMN = (0, 2, 1)  # of a joint's frame for its first, middle and last axis


def body_blueprint(rig: BodyRig) -> Blueprint:
    """Blueprint of the body, from the tensors of `BodyRig.coefficients`."""
    geometry = body_geometry()
    channels: dict[str, Channel] = {}
    values: list[Value] = []
    factors = rig.angles.double().unflatten(1, (-1, 3)).cpu().numpy()
    for joint, name in enumerate(rig.joint_names):
        for axis in range(3):
            controls = np.flatnonzero(factors[:, joint, axis])
            if len(controls):
                value = f"{name} rotation {axis}"
                values.append(_sum(value, [rig.control_names[c] for c in controls], factors[controls, joint, axis]))
                channels[value] = Channel(name, "rotation", COLUMN[axis])
    frames = rig.frames.double().cpu().numpy()
    for axis, direction in enumerate(frames[0].T):
        value = f"{rig.joint_names[0]} move {axis}"
        values.append(_sum(value, MOVES, direction))
        channels[value] = Channel(rig.joint_names[0], "location", axis)
    lengths = torch.linalg.vector_norm(geometry["tails"] - geometry["heads"], dim=1).clamp_min(1.0)
    skeleton = Skeleton(
        tuple(rig.joint_names),
        tuple(rig.parents),
        geometry["heads"].numpy(),
        lengths.numpy(),
        frames,
        BLENDER_ORDER,
        geometry["weights"].numpy(),
        channels,
    )
    rest, faces = rig.rest_vertices.cpu().numpy(), rig.faces.cpu().numpy()
    return Blueprint(rig.name, rig.controls, values, (), rest, faces, np.zeros((0, *rest.shape), np.float32), skeleton)


def _sum(name: str, controls: list[str] | tuple[str, ...], factors: np.ndarray) -> Value:
    return Value(name, "sum", tuple(controls), tuple(factors.tolist()), of_controls=True)
