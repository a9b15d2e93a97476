"""A trained inverse, ready for use: meshes in, controls out.

from riginv.inverse import load_inverse

inverse = load_inverse("runs/face-inverse/2026-11-22_10-00-00/bundle")
controls = inverse(vertices)  # (frame, 8447, 3) in mm -> (frame, 137)
"""

import functools
from pathlib import Path

import torch
from torch import Tensor, nn

from riginv.build import OURS, build
from riginv.bundle import RIG, Bundle, read_bundle
from riginv.encoder import QuickEncoder
from riginv.errors import InputError
from riginv.fitted_rig import FittedRig
from riginv.mesh_space import MeshSpace, RigInMeshSpace
from riginv.networks.inverse import InverseNetwork
from riginv.rig import LinearRig, RigBackend
from riginv.solvers.every_mesh import refine_meshes
from riginv.solvers.objective import Objective

WORTH_ROUNDING = 1_000_000  # numbers of a frame: below it there is nothing to gain


class Inverse(nn.Module):
    """Maps meshes to the controls of a rig.

    Args:
        refine: steps of Levenberg-Marquardt that follow the network, mesh by mesh.
        trained_seconds: what its training took.

    Attributes:
        network: from mesh coordinates to controls; it knows its rig and its mesh space.
    """

    def __init__(self, network: InverseNetwork, refine: int = 0, trained_seconds: float = 0.0) -> None:
        super().__init__()
        self.network, self.refine, self.trained_seconds = network, refine, trained_seconds
        space = network.rig.space
        self.encoder = QuickEncoder(space, network.rig.rig.has_blendshapes and space.frame.numel() >= WORTH_ROUNDING)

    @property
    def rig(self) -> LinearRig:
        return self.network.rig.rig

    @torch.no_grad()
    def forward(self, vertices: Tensor) -> Tensor:
        """Meshes `(batch, vertex, 3)`, mm, to controls `(batch, control)` within the rig's limits.

        Raises:
            InputError: the meshes do not have the rig's number of vertices.
        """
        space = self.network.rig.space
        if vertices.shape[1:] != space.rest_vertices.shape:
            raise InputError(
                f"meshes of shape {tuple(vertices.shape)} were given, rig '{self.rig.name}' needs "
                f"(mesh, {space.vertex_count}, 3): the same vertices in the same order"
            )
        if not self.refine:
            return self.network(self.encoder(vertices))
        coordinates = space.encode(vertices)
        controls = self.network(coordinates)
        start = self.objective.units(controls)
        return self.objective.own_units(refine_meshes(self.objective, coordinates, start, self.refine).units)

    @functools.cached_property
    def objective(self) -> Objective:
        """What the steps after the network minimise; made where the network is when they are first asked for."""
        return Objective(self.network.rig)


def load_inverse(folder: str | Path, rig: RigBackend | None = None, refine: int = 0) -> Inverse:
    """Load the inverse of a bundle.

    Args:
        folder: the bundle, or the run that holds it.
        rig: the rig, for one that is not part of riginv; else the bundle's own description builds it. An inverse that was
            trained through a surrogate brings that along, and only asks whether it stands for this rig.
        refine: steps of Levenberg-Marquardt that follow the network, through the rig that it was trained on.

    Raises:
        InputError: the bundle is missing, damaged, of another kind or made for another rig.
    """
    bundle = read_bundle(folder, kind="inverse")
    if rig is not None:
        bundle.check_rig(rig)
    if rig is None or bundle.holds_surrogate:
        rig = bundle_rig(bundle)
        bundle.check_rig(rig)
    space = MeshSpace(bundle.space["rest_vertices"], bundle.space["frame"])
    if not isinstance(rig, LinearRig):
        rig = FittedRig(rig, (bundle.space["linear_map"] @ space.frame.flatten(1)).unflatten(1, rig.rest_vertices.shape))
    network = build(bundle.description["network"], RigInMeshSpace(rig, space), kind=InverseNetwork, only=OURS)
    network.load_own_weights(bundle.weights)
    trained_seconds = float(bundle.description["training"].get("seconds", 0.0))
    return Inverse(network, refine, trained_seconds).eval().requires_grad_(False)


def bundle_rig(bundle: Bundle) -> RigBackend:
    """The rig that a bundle describes: one of ours, or the surrogate that lies within the bundle."""
    config = dict(bundle.description["rig"]["config"])
    if bundle.holds_surrogate:
        config["bundle"] = str(bundle.folder / RIG)
    return build(config, kind=RigBackend, only=OURS)
