"""The identity of a rig, for stores of its poses: a hash of its exact properties, and a fingerprint of a few meshes."""

import hashlib
import json
import math
from typing import Any

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig
from riginv.rig.random_controls import sparse_controls

SEED = 20221206
PROBES, FIELDS = 8, 8
TOLERANCE_MM = 0.01  # of fingerprints: rounding differs between machines; 1 mm at one of 10,000 vertices makes as much


def describe(rig: LinearRig, config: dict[str, Any]) -> dict[str, Any]:
    """A rig's controls with their limits, the hash of its exact properties, and its fingerprint.

    Args:
        config: the rig's config; kept for people to read.
    """
    return {
        "name": rig.name,
        "config": config,
        "controls": [vars(control) for control in rig.controls],
        "vertex_count": len(rig.rest_vertices),
        "linear": not rig.is_fitted,
        "coefficient_names": list(rig.coefficient_names),
        "hash": rig_hash(rig),
        "fingerprint_mm": fingerprint(rig).tolist(),
    }


def rig_hash(rig: LinearRig) -> str:
    """SHA-256 of a rig's controls, faces, number of vertices, and coefficient names unless its basis was fitted."""
    names = [] if rig.is_fitted else list(rig.coefficient_names)
    exact = json.dumps([[vars(control) for control in rig.controls], len(rig.rest_vertices), names])
    return hashlib.sha256(exact.encode() + rig.faces.cpu().numpy().astype("<i8").tobytes()).hexdigest()


@torch.no_grad()
def fingerprint(rig: LinearRig) -> Tensor:
    """A rig's displacements in eight random poses, projected on fields of random signs: `(probe, field)`, mm."""
    limits = rig.lower, rig.upper, rig.neutral_controls
    controls = sparse_controls(*limits, len(rig.controls), PROBES, generator_at(SEED, "probes"))
    change = (rig.posing_rig()(controls) - rig.rest_vertices).flatten(1).double().nan_to_num(0.0, 0.0, 0.0)
    signs = torch.randint(0, 2, (change.shape[1], FIELDS), generator=generator_at(SEED, "signs")).double() * 2 - 1
    return change @ signs / math.sqrt(len(rig.rest_vertices))


def check_same_rig(where: str, described: dict[str, Any], rig: LinearRig) -> None:
    """Raises InputError where a store or a prior is of another rig; a surrogate's meshes are not compared."""
    begin = f"{where} was made with rig '{described['name']}', and rig '{rig.name}'"
    end = "name the rig that it was made with, or make another with this one"
    theirs, ours = described["controls"], [vars(control) for control in rig.controls]
    if len(theirs) != len(ours):
        raise InputError(f"{begin} has {len(ours)} controls instead of {len(theirs)}: {end}")
    for number, (one, other) in enumerate(zip(theirs, ours)):
        if one != other:
            raise InputError(f"{begin} has {other} as control {number} instead of {one}: {end}")
    if described["vertex_count"] != len(rig.rest_vertices):
        raise InputError(f"{begin} has {len(rig.rest_vertices)} vertices instead of {described['vertex_count']}: {end}")
    if described["linear"] and described["coefficient_names"] != list(rig.coefficient_names):
        raise InputError(f"{begin} has other coefficients or faces: {end}")
    if rig.is_surrogate:
        return
    difference = float((fingerprint(rig) - torch.tensor(described["fingerprint_mm"], dtype=torch.float64)).abs().max())
    if described["hash"] != rig_hash(rig) or not difference <= TOLERANCE_MM:
        raise InputError(f"{begin} has the same controls but makes other meshes of them: {end}")
