"""Blueprints: rigs as graphs of plain values, which animation software can rebuild with drivers."""

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
    """A scalar of a rig, computed from controls and earlier values.

    Attributes:
        name: unique among values.
        operation: `sum` of the inputs times `factors`, `product`, `screen` 1 - (1 - a)(1 - b)..., or the `least` input.
        inputs: names of values, or of controls where `of_controls` is set.
        factors: of a sum, one for each input.
        curve: applied to the result.
    """

    name: str
    operation: Operation
    inputs: tuple[str, ...]
    factors: tuple[float, ...] = ()
    curve: Curve = field(default_factory=list)
    of_controls: bool = False


class Channel(NamedTuple):
    """A degree of freedom of a joint: `rotation` (radians) about or `location` (mm) along an axis of its frame."""

    joint: str
    kind: Literal["rotation", "location"]
    axis: int


@dataclass(frozen=True)
class Skeleton:
    """A skeleton for linear blend skinning.

    Attributes:
        names: of the joints, parents before their children.
        parents: index of each joint's parent, -1 for a root.
        heads: `(joint, 3)`, mm.
        lengths: display lengths of the bones, `(joint,)`, mm.
        frames: `(joint, 3, 3)`, whose columns are the axes of each joint at rest; the bone is along the second.
        order: of rotations, as in `YZX`: first about the second axis.
        weights: skin weights `(vertex, joint)`.
        channels: driven degree of freedom by name of the value.
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
        """Everything except the arrays, for JSON."""
        return {"names": self.names, "parents": self.parents, "order": self.order, "channels": self.channels}


@dataclass(frozen=True)
class Blueprint:
    """Complete description of a rig of shapes or joints.

    Attributes:
        name: of the rig.
        controls: of the rig.
        values: in an order of evaluation.
        shapes: names of the values that are weights of shapes.
        rest_vertices: `(vertex, 3)`, mm, y up.
        faces: `(face, 3)`.
        deltas: `(shape, vertex, 3)`, mm.
        skeleton: None for rigs without joints.
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
        """Everything except the arrays, as JSON."""
        facts = {
            "name": self.name,
            "shapes": self.shapes,
            "controls": [asdict(control) for control in self.controls],
            "values": [asdict(value) for value in self.values],
            "skeleton": self.skeleton and self.skeleton.facts(),
        }
        return json.dumps(facts)

    def arrays(self) -> dict[str, np.ndarray]:
        arrays = {"rest_vertices": self.rest_vertices, "faces": self.faces, "deltas": self.deltas}
        if self.skeleton:
            arrays |= {name: getattr(self.skeleton, name) for name in Skeleton.ARRAYS}
        return arrays

    def content_hash(self) -> str:
        """SHA-256 of the blueprint, in hexadecimal."""
        digest = hashlib.sha256(self.facts().encode())
        for array in self.arrays().values():
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()

    def save(self, path: Path) -> None:
        """Write an .npz without pickled objects."""
        arrays: dict[str, Any] = {"facts": np.frombuffer(self.facts().encode(), np.uint8), **self.arrays()}
        np.savez(path, **arrays)


def unpack_curves(table: Tensor) -> list[Curve]:
    """Curves of a table `(curve, segment, 9)` of `riginv.geometry.curves.pack_curves`."""
    return [_curve([segment for segment in rows if segment[1] > 0]) for rows in table.double().tolist()]


def _curve(segments: list[list[float]]) -> Curve:
    keys, left = [], (0.0, 0.0)
    for start, width, _, b, c, d, e, f, g in segments:
        right = (width * c / 3, f / 3)
        keys.append(Key(start, g, left, right))
        inner = (width * (b + 2 * c) / 3, (e + 2 * f) / 3)  # second handle relative to the start of the segment
        left = (inner[0] - width, inner[1] - (d + e + f))
    start, width, *_, d, e, f, g = segments[-1]
    return [*keys, Key(start + width, d + e + f + g, left)]
