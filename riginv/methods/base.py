"""The interface of methods of rig inversion."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

import torch
from torch import Tensor

from riginv.config.building import ClassSpec
from riginv.errors import InputError
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace


class Method(ABC):
    """A method of rig inversion. `conf/methods/NAME.yaml` names the class and its arguments under the key NAME.

    A method of yours is a class and such a file, in a folder that `--config-dir` names: its class takes the rig in its mesh
    space first, then the arguments of the file.

    Args:
        rig: the rig to invert, in its mesh space. It may be a surrogate; errors are computed on the true rig.

    Attributes:
        rig: the same.
        seed: of all random draws; set by `prepare`.
        fingerprint: hash of what the config does not determine, such as a bundle's weights; when it changes, `compare` reruns.
        trained_seconds: what was spent on training before, as on a network that is loaded; `compare` adds it to its own.
        source: what is implemented: the paper, and what was changed and why.
    """

    source: str = ""

    def __init__(self, rig: RigInMeshSpace) -> None:
        self.rig = rig
        self.seed, self.trained_seconds, self.fingerprint = 0, 0.0, ""

    @classmethod
    def unsuited(cls, rig: LinearRig) -> str:
        """The reason why the method cannot invert a rig, such as "it has no blendshapes"; empty where it can."""
        return ""

    def prepare(self, seed: int) -> None:
        """Train, fit or tabulate what the method needs before its first mesh; `compare` times it as `training_seconds`.

        Called once, before `invert`; equal seeds must give equal results. Most methods only keep the seed.
        """
        self.seed = seed

    @abstractmethod
    def invert(self, meshes: MeshSet) -> Tensor:
        """Controls `(mesh, control)`, within the rig's limits, for all meshes in order.

        Where `meshes.fps` is set they are the frames of a clip, and a method may use that. `meshes.controls`, where there are
        any, are the answer: no method may look at them.
        """

    def coordinates(self, meshes: MeshSet) -> Tensor:
        """All meshes `(mesh, coordinate)` in mesh coordinates, read in batches: never all vertices at once."""
        return encoded(meshes, self.rig.space)


class BatchedMethod(Method):
    """A method that solves for each mesh on its own.

    Attributes:
        batch_size: how many at a time.
    """

    batch_size = 64

    def invert(self, meshes: MeshSet) -> Tensor:
        """As `Method.invert`; a mesh with NaN or infinite values is replaced by the rest mesh."""
        coordinates = self.coordinates(meshes)
        whole = torch.isfinite(coordinates).all(dim=1, keepdim=True)
        answers = [self.solve(batch) for batch in torch.where(whole, coordinates, 0.0).split(self.batch_size) if len(batch)]
        return torch.cat(answers) if answers else coordinates.new_zeros(0, len(self.rig.source.controls))

    @abstractmethod
    def solve(self, coordinates: Tensor) -> Tensor:
        """Controls `(mesh, control)` of meshes `(mesh, coordinate)`."""


def encoded(meshes: MeshSet, space: MeshSpace) -> Tensor:
    """All meshes of a set in the coordinates of a mesh space, `(mesh, coordinate)`, read in batches."""
    pieces = [space.encode(vertices) for _, vertices in meshes.batches()]
    return torch.cat(pieces) if pieces else space.directions.new_zeros(0, space.size)


def suited_methods(specs: Mapping[str, ClassSpec[Method]], rig: RigInMeshSpace) -> tuple[dict[str, Method], dict[str, str]]:
    """The methods that a config names, ready for the rig, and why others are left out, by name.

    Raises:
        InputError: nothing is named, or nothing of it can invert the rig.
    """
    if not specs:
        raise InputError("methods names nothing to compare: methods=[NAME,NAME,...]")
    reasons = {name: spec.target_class.unsuited(rig.source) for name, spec in specs.items()}
    methods = {name: spec.build(rig) for name, spec in specs.items() if not reasons[name]}
    left_out = {name: reason for name, reason in reasons.items() if reason}
    if not methods:
        whys = "; ".join(f"{name}: {reason}" for name, reason in left_out.items())
        raise InputError(
            f"none of the methods can invert rig '{rig.source.name}' ({whys}): choose others with methods=[NAME,...]"
        )
    return methods, left_out
