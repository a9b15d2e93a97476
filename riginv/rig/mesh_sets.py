"""Fixed sets of meshes to judge on, made piece by piece: a set larger than memory costs no more than a small one."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterator

import torch
from torch import Tensor

from riginv.rig.interface import RigBackend


class MeshSet(ABC):
    """A fixed, ordered set of meshes.

    Attributes:
        name: the set's key in metrics.
        fps: frames a second where the set is a clip, else None.
        controls: the controls `(mesh, control)` that made the meshes, where they are poses of the rig, else None.
        frame_numbers: of a clip, `(mesh,)`, rising, with gaps where frames are missing; None: one after the other.
        notes: what was guessed, mended or left out as it was read or made, in whole sentences, for the user.
    """

    notes: tuple[str, ...] = ()

    def __init__(
        self, name: str, fps: float | None = None, controls: Tensor | None = None, frame_numbers: Tensor | None = None
    ) -> None:
        self.name, self.fps, self.controls, self.frame_numbers = name, fps, controls, frame_numbers

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def vertices(self, start: int, stop: int) -> Tensor:
        """The meshes `start` to `stop`, `(mesh, vertex, 3)`, mm."""

    def known(self, start: int, stop: int) -> Tensor | None:
        """Which vertices of the meshes `start` to `stop` errors are measured at, `(mesh, vertex)`; None: all of them."""
        return None

    def named(self, name: str) -> "MeshSet":
        """The same set under another name."""
        twin = copy.copy(self)
        twin.name = name
        return twin

    def batches(self, size: int = 128) -> Iterator[tuple[int, Tensor]]:
        """All meshes in order, `size` at a time: where the piece starts, and its vertices."""
        for start in range(0, len(self), size):
            yield start, self.vertices(start, min(start + size, len(self)))


class WeightedShapes(MeshSet):
    """Shapes added linearly to a rest mesh.

    Args:
        rest_vertices: `(vertex, 3)`, mm.
        deltas: `(shape, vertex, 3)`, mm.
        weights: `(mesh, shape)`.
    """

    def __init__(
        self,
        name: str,
        rest_vertices: Tensor,
        deltas: Tensor,
        weights: Tensor,
        fps: float | None = None,
        frame_numbers: Tensor | None = None,
    ) -> None:
        super().__init__(name, fps, frame_numbers=frame_numbers)
        self.rest_vertices, self.deltas, self.weights = rest_vertices, deltas, weights.to(deltas.dtype)

    def __len__(self) -> int:
        return len(self.weights)

    def vertices(self, start: int, stop: int) -> Tensor:
        return self.rest_vertices + (self.weights[start:stop] @ self.deltas.flatten(1)).unflatten(1, self.rest_vertices.shape)


class StoredMeshes(MeshSet):
    """Meshes as they are.

    Args:
        meshes: `(mesh, vertex, 3)`, mm.
    """

    def __init__(self, name: str, meshes: Tensor, fps: float | None = None, controls: Tensor | None = None) -> None:
        super().__init__(name, fps, controls)
        self.meshes = meshes

    def __len__(self) -> int:
        return len(self.meshes)

    def vertices(self, start: int, stop: int) -> Tensor:
        return self.meshes[start:stop]


class PosedRig(MeshSet):
    """Poses of a rig.

    Args:
        controls: `(mesh, control)`.
    """

    def __init__(self, name: str, rig: RigBackend, controls: Tensor) -> None:
        super().__init__(name, controls=controls)
        self.rig = rig

    def __len__(self) -> int:
        return len(self.controls)

    @torch.no_grad()
    def vertices(self, start: int, stop: int) -> Tensor:
        return self.rig(self.controls[start:stop])
