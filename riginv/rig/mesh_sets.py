"""Fixed sets of meshes to evaluate on, made batch by batch: a set may be larger than memory."""

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
        fps: frames per second where the set is a clip, else None.
        controls: the controls `(mesh, control)` of the meshes, where they are poses of the rig, else None.
        frame_numbers: of a clip, `(mesh,)`, ascending, with gaps where frames are missing; None: consecutive.
        notes: sentences for the user about what was guessed, repaired or left out.
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
        """The meshes from `start` to before `stop`, `(mesh, vertex, 3)`, mm."""

    def known(self, start: int, stop: int) -> Tensor | None:
        """A mask `(mesh, vertex)` of the vertices that errors are measured at, for the same meshes; None: all of them."""
        return None

    def named(self, name: str) -> "MeshSet":
        """The same set under another name."""
        renamed = copy.copy(self)
        renamed.name = name
        return renamed

    def batches(self, size: int = 128) -> Iterator[tuple[int, Tensor]]:
        """Yields all meshes in order, `size` at a time: the index of the first of a batch, and their vertices."""
        for start in range(0, len(self), size):
            yield start, self.vertices(start, min(start + size, len(self)))


class WeightedShapes(MeshSet):
    """Meshes that are weighted sums of shapes on a rest mesh.

    Args:
        rest_vertices: `(vertex, 3)`, mm.
        deltas: `(shape, vertex, 3)`, mm.
        weights: `(mesh, shape)`.
    """

    def __init__(self, name: str, rest_vertices: Tensor, deltas: Tensor, weights: Tensor, fps: float | None = None) -> None:
        super().__init__(name, fps)
        self.rest_vertices, self.deltas, self.weights = rest_vertices, deltas, weights.to(deltas.dtype)

    def __len__(self) -> int:
        return len(self.weights)

    def vertices(self, start: int, stop: int) -> Tensor:
        return self.rest_vertices + (self.weights[start:stop] @ self.deltas.flatten(1)).unflatten(1, self.rest_vertices.shape)


class StoredMeshes(MeshSet):
    """Meshes in memory.

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

    controls: Tensor

    def __init__(self, name: str, rig: RigBackend, controls: Tensor) -> None:
        super().__init__(name, controls=controls)
        self.rig = rig

    def __len__(self) -> int:
        return len(self.controls)

    @torch.no_grad()
    def vertices(self, start: int, stop: int) -> Tensor:
        return self.rig(self.controls[start:stop])
