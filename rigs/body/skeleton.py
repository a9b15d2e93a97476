"""The skeleton that MakeHuman gives its base mesh, less the bones that only a face needs."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

SIDED = (
    *("upperleg01", "upperleg02", "lowerleg01", "lowerleg02", "foot", "toe1-1"),
    *("clavicle", "shoulder01", "upperarm01", "upperarm02", "lowerarm01", "lowerarm02", "wrist"),
    *(f"metacarpal{number}" for number in range(1, 5)),
    *(f"finger{finger}-{bone}" for finger in range(1, 6) for bone in range(1, 4)),
)
CENTRAL = ("root", *(f"spine0{number}" for number in range(5, 0, -1)), "neck01", "neck02", "neck03", "head", "jaw")
KEPT = (*CENTRAL, *(f"{name}.{side}" for side in "LR" for name in ("pelvis", *SIDED)))


@dataclass(frozen=True)
class Skeleton:
    """Joints at rest, in MakeHuman's names (`upperarm01.L`), mm, y up, z out of the face.

    Attributes:
        names: of the joints.
        parents: the number of each joint's parent, -1 for the root.
        heads, tails: where each bone begins and ends, `(joint, 3)`.
        rolls: of each bone about itself, radians, as Blender counts it.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    heads: np.ndarray
    tails: np.ndarray
    rolls: np.ndarray

    @cached_property
    def number(self) -> dict[str, int]:
        """The number of each joint."""
        return {name: number for number, name in enumerate(self.names)}
