"""A rig as a blueprint: plain values that follow from each other, which animation software can rebuild with drivers."""

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from torch import Tensor

from riginv.geometry.curves import Curve, Key
from riginv.rig import Control

Operation = Literal["sum", "product", "screen", "least"]


@dataclass(frozen=True)
class Value:
    """One number of a rig, computed from controls and from values that stand before it.

    Attributes:
        name: unique among values.
        operation: `sum` of the inputs times `factors`, `product`, `screen` 1 - (1 - a)(1 - b)..., or the `least` input.
        inputs: names of values, or, where `of_controls`, of controls.
        factors: of a sum, one for each input.
        curve: through which the result goes.
    """

    name: str
    operation: Operation
    inputs: tuple[str, ...]
    factors: tuple[float, ...] = ()
    curve: Curve = field(default_factory=list)
    of_controls: bool = False


@dataclass(frozen=True)
class Blueprint:
    """All that is needed to rebuild a blendshape rig elsewhere.

    Attributes:
        name: of the rig.
        controls: the rig's.
        values: in an order in which they can be computed.
        shapes: the values that are weights of shapes.
        rest_vertices: `(vertex, 3)`, mm, y up.
        faces: `(face, 3)`.
        deltas: `(shape, vertex, 3)`, mm.
    """

    name: str
    controls: tuple[Control, ...]
    values: list[Value]
    shapes: tuple[str, ...]
    rest_vertices: np.ndarray
    faces: np.ndarray
    deltas: np.ndarray

    def facts(self) -> str:
        """All but the arrays, as JSON."""
        facts = {"name": self.name, "shapes": self.shapes}
        facts["controls"] = [asdict(control) for control in self.controls]
        facts["values"] = [asdict(value) for value in self.values]
        return json.dumps(facts)

    def content_hash(self) -> str:
        """Of everything in it, in hexadecimal."""
        digest = hashlib.sha256(self.facts().encode())
        for array in (self.rest_vertices, self.faces, self.deltas):
            digest.update(np.ascontiguousarray(array))
        return digest.hexdigest()

    def save(self, path: Path) -> None:
        """Write it as an .npz that NumPy reads without running code."""
        facts = np.frombuffer(self.facts().encode(), np.uint8)
        np.savez(path, facts=facts, rest_vertices=self.rest_vertices, faces=self.faces, deltas=self.deltas)


def unpack_curves(table: Tensor) -> list[Curve]:
    """The curves of a table of `riginv.geometry.curves.pack_curves`, `(curve, segment, 9)`."""
    return [_curve([segment for segment in rows if segment[1] > 0]) for rows in table.double().tolist()]


def _curve(segments: list[list[float]]) -> Curve:
    keys, left = [], (0.0, 0.0)
    for start, width, _, b, c, d, e, f, g in segments:
        right = (width * c / 3, f / 3)
        keys.append(Key(start, g, left, right))
        inner = (width * (b + 2 * c) / 3, (e + 2 * f) / 3)  # of the second handle, from the start of the segment
        left = (inner[0] - width, inner[1] - (d + e + f))
    start, width, *_, d, e, f, g = segments[-1]
    return [*keys, Key(start + width, d + e + f + g, left)]
