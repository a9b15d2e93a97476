"""Blendshape rigs in the terms of the format: lines and hats as rows of the table, products as PSDs."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rigs.dna.draft import Draft, MeshDraft, Row
from rigs.dna.format.ragged import Ragged


class Drive(NamedTuple):
    """A weight driven linearly by a GUI control, from 0 at one of its values to 1 at another."""

    gui: str
    zero: float = 0.0
    one: float = 1.0

    def at(self, weight: float) -> float:
        """Value of the GUI control at a weight."""
        return self.zero + weight * (self.one - self.zero)


class Factor(NamedTuple):
    """A factor of a shape's weight: a driven weight, or a hat function of it.

    Attributes:
        name: of the raw control that holds it.
        weight: the name of the driven weight.
        hat: knots of the hat function, 1 at the middle one; None: the weight itself.
    """

    name: str
    weight: str
    hat: tuple[float, float, float] | None = None


class Shape(NamedTuple):
    """A blendshape.

    Attributes:
        factors: its weight is their product.
        deltas: `(vertex, 3)`, mm.
    """

    name: str
    factors: Sequence[Factor]
    deltas: np.ndarray


def blendshape_draft(
    name: str, rest: np.ndarray, faces: Ragged, drives: dict[str, Drive], shapes: Sequence[Shape], guis: Sequence[str] = ()
) -> Draft:
    """A draft of a blendshape rig.

    Args:
        rest: `(vertex, 3)`, mm.
        drives: of each weight, by name.
        guis: order of the GUI controls; default: that of `drives`.
    """
    draft = Draft(name, gui=list(guis) or list(dict.fromkeys(drive.gui for drive in drives.values())))
    index_of: dict[str, int] = {}
    for factor in _factors(drives, shapes):
        index_of[factor.name] = len(draft.raw)
        draft.raw.append(factor.name)
        draft.rows += _rows(drives[factor.weight], factor)
    products: dict[tuple[int, ...], int] = {}
    for shape in shapes:
        members = tuple(index_of[factor.name] for factor in shape.factors)
        if len(members) == 1:
            control = members[0]
        else:
            control = len(draft.raw) + products.setdefault(members, len(products))
        draft.channels.append((shape.name, control))
    draft.psds = list(products)
    draft.meshes = [MeshDraft(name, rest, faces, None, {number: shape.deltas for number, shape in enumerate(shapes)})]
    return draft


def _factors(drives: dict[str, Drive], shapes: Sequence[Shape]) -> list[Factor]:
    """Unique factors, the driven weights first."""
    found = {name: Factor(name, name) for name in drives}
    for shape in shapes:
        for factor in shape.factors:
            found.setdefault(factor.name, factor)
    return list(found.values())


def _rows(drive: Drive, factor: Factor) -> list[Row]:
    """Table rows of a factor, by ascending values of its GUI control."""
    knots = [(0.0, 0.0), (1.0, 1.0)]
    if factor.hat is not None:
        left, middle, right = factor.hat
        knots = [(left, 0.0), (middle, 1.0), (right, 0.0)]
    points = sorted((drive.at(weight), value) for weight, value in knots)
    return [Row.between(drive.gui, factor.name, *ends) for ends in itertools.pairwise(points)]


def triangles(faces: np.ndarray) -> Ragged:
    """Triangles `(face, 3)` as polygons."""
    return Ragged(np.asarray(faces).reshape(-1), np.full(len(faces), 3))
