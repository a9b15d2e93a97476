"""A rig as a blueprint: plain values that follow from each other, which animation software can rebuild with drivers."""

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from torch import Tensor

from riginv.geometry.curves import Curve, Key
from riginv.rig.interface import Control

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


class Channel(NamedTuple):
    """What a value does to a joint: its `rotation` (radians) about, or its `location` (mm) along an axis of its frame."""

    joint: str
    kind: Literal["rotation", "location"]
    axis: int


@dataclass(frozen=True)
class Skeleton:
    """Joints that carry a mesh by linear blend skinning.

    Attributes:
        names: of the joints, parents before their children.
        parents: the number of each joint's parent, -1 for a root.
        heads: `(joint, 3)`, mm.
        lengths: `(joint,)`, mm, of the bones, for the eye.
        frames: `(joint, 3, 3)`, whose columns are the axes of each joint at rest; the bone lies along the second.
        order: in which a joint turns about its axes, as in `YZX`: first about the second.
        weights: `(vertex, joint)`.
        channels: by name of the value.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    heads: np.ndarray
    lengths: np.ndarray
    frames: np.ndarray
    order: str
    weights: np.ndarray
    channels: dict[str, Channel]

    ARRAYS: ClassVar = ("heads", "lengths", "frames", "weights")

    def facts(self) -> dict[str, Any]:
        """All but the arrays, for JSON."""
        return {"names": self.names, "parents": self.parents, "order": self.order, "channels": self.channels}


@dataclass(frozen=True)
class Blueprint:
    """All that is needed to rebuild a rig of shapes or joints elsewhere.

    Attributes:
        name: of the rig.
        controls: the rig's.
        values: in an order in which they can be computed.
        shapes: the values that are weights of shapes.
        rest_vertices: `(vertex, 3)`, mm, y up.
        faces: `(face, 3)`.
        deltas: `(shape, vertex, 3)`, mm.
        skeleton: of a rig that has one.
    """

    name: str
    controls: tuple[Control, ...]
    values: list[Value]
    shapes: tuple[str, ...]
    rest_vertices: np.ndarray
    faces: np.ndarray
    deltas: np.ndarray
    skeleton: Skeleton | None = None

    def facts(self) -> str:
        """All but the arrays, as JSON."""
        facts = {"name": self.name, "shapes": self.shapes}
        facts["controls"] = [asdict(control) for control in self.controls]
        facts["values"] = [asdict(value) for value in self.values]
        facts["skeleton"] = self.skeleton and self.skeleton.facts()
        return json.dumps(facts)

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays by name."""
        arrays = {"rest_vertices": self.rest_vertices, "faces": self.faces, "deltas": self.deltas}
        if self.skeleton:
            arrays |= {name: getattr(self.skeleton, name) for name in Skeleton.ARRAYS}
        return arrays

    def content_hash(self) -> str:
        """Of everything in it, in hexadecimal."""
        digest = hashlib.sha256(self.facts().encode())
        for array in self.arrays().values():
            digest.update(np.ascontiguousarray(array))
        return digest.hexdigest()

    def save(self, path: Path) -> None:
        """Write it as an .npz that NumPy reads without running code."""
        np.savez(path, facts=np.frombuffer(self.facts().encode(), np.uint8), **self.arrays())


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
