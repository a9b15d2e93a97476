"""A trained inverse among the methods."""

import hashlib

import torch
from torch import Tensor

from riginv.config.values import NonNegativeInt
from riginv.errors import InputError
from riginv.inference.inverse import Inverse, load_inverse
from riginv.methods.base import Method, encoded
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import RigInMeshSpace

BATCH_SIZE = 512


class Network(Method):
    """The network of a bundle, trained by `python -m riginv.train`; its training time is the bundle's.

    Args:
        bundle: the bundle of an inverse, or the run that holds it.
        mean_steps: steps on the mean vertex distance that follow the network.

    Raises:
        InputError: the bundle is missing, damaged, or made for another rig.
    """

    source = "Rig inversion by training a differentiable rig function (SIGGRAPH Asia 2022), and riginv's staged network"

    def __init__(self, rig: RigInMeshSpace, bundle: str, mean_steps: NonNegativeInt = 0) -> None:
        super().__init__(rig)
        if not isinstance(bundle, str):
            raise InputError(f"bundle is {bundle!r}, expected the bundle of an inverse, or the run that holds it")
        self.inverse: Inverse = load_inverse(bundle, rig.source, mean_steps=mean_steps)
        self.trained_seconds = self.inverse.trained_seconds
        digest = hashlib.sha256()
        for weights in self.inverse.network.own_weights().values():
            digest.update(weights.cpu().contiguous().numpy().tobytes())
        self.fingerprint = digest.hexdigest()[:16]

    @torch.no_grad()
    def invert(self, meshes: MeshSet) -> Tensor:
        """As `Method.invert`, in the mesh space of the network, whose axes may differ from those of `rig`."""
        coordinates = encoded(meshes, self.inverse.network.rig.space)
        if not len(coordinates):
            return self.rig.source.lower.new_zeros(0, len(self.rig.source.controls))
        controls = torch.cat([self.inverse.answer(piece) for piece in coordinates.split(BATCH_SIZE)])
        steps = self.inverse.mean_steps
        return self.inverse.after_mean_steps(coordinates, controls, steps) if steps else controls
