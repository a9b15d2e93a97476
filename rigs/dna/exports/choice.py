"""Drafts of DNA files from rigs, and the reasons why some rigs have none."""

from collections.abc import Callable

import torch

from riginv.errors import InputError
from riginv.rig.contract import random_controls
from riginv.rig.interface import LinearRig, RigBackend
from rigs.body import BodyRig
from rigs.dna.draft import Draft
from rigs.dna.exports.blendshapes import Drive, Factor, Shape, blendshape_draft, triangles
from rigs.dna.exports.gltf import draft_of_gltf
from rigs.dna.exports.joints import draft_of_body
from rigs.dna.exports.shapes import draft_of_shapes
from rigs.dna.rig import DnaRig
from rigs.face import FaceRig
from rigs.gltf import GltfRig
from rigs.shapes import ShapesRig

WRITERS: dict[type, Callable[..., Draft]] = {ShapesRig: draft_of_shapes, GltfRig: draft_of_gltf, BodyRig: draft_of_body}
HOLDS = "a DNA file holds lines between values of a control, hats, products, and joints that move in proportion to controls"


def draft_of(rig: RigBackend) -> Draft:
    """A rig as a draft of a DNA file.

    User-defined rigs may implement a method `dna_draft() -> Draft`.

    Raises:
        InputError: the format cannot represent the rig; the message has the reason.
    """
    if hasattr(rig, "dna_draft"):
        return rig.dna_draft()  # type: ignore[operator]  # torch annotates attributes of modules as tensors
    for kind, writer in WRITERS.items():
        if isinstance(rig, kind):
            return writer(rig)
    if isinstance(rig, DnaRig):
        raise InputError(f"rig '{rig.name}' is a DNA file already: copy it with python -m rigs.dna.copy")
    if isinstance(rig, FaceRig):
        raise InputError(
            f"rig '{rig.name}' cannot be written: its weights follow controls along Bezier curves, several drivers of a shape "
            f"screen each other, regions yield only so far, and mouthClose has a ceiling, where {HOLDS}"
        )
    if isinstance(rig, LinearRig) and _is_plain(rig):
        return _plain_draft(rig)
    raise InputError(
        f"rig '{rig.name}' ({type(rig).__name__}) cannot be written: its class does not describe its logic; {HOLDS}: give "
        f"it a method dna_draft() (docs/dna.md)"
    )


def _is_plain(rig: LinearRig) -> bool:
    """Whether the controls are the weights of the shapes, 0 at rest."""
    if not len(rig.controls) == rig.primary_count == len(rig.basis) or any(c.neutral for c in rig.controls):
        return False
    controls = random_controls(rig, 8, 0)
    with torch.no_grad():
        return bool((rig.coefficients(controls) == controls).all())


def _plain_draft(rig: LinearRig) -> Draft:
    deltas = rig.basis.double().numpy(force=True)
    shapes = [Shape(name, [Factor(name, name)], delta) for name, delta in zip(rig.control_names, deltas)]
    drives = {name: Drive(name) for name in rig.control_names}
    rest = rig.rest_vertices.double().numpy(force=True)
    return blendshape_draft(rig.name, rest, triangles(rig.faces.numpy(force=True)), drives, shapes)
