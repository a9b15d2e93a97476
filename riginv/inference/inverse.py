"""A trained inverse, ready for use: meshes in, controls out.

from riginv.inference.inverse import load_inverse

inverse = load_inverse("runs/face-inverse/2026-11-22_10-00-00/bundle")
controls = inverse(vertices)  # (frame, 8447, 3) in mm -> (frame, 137)
"""

import functools
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn

from riginv.config.building import OURS, build, class_of
from riginv.errors import InputError
from riginv.geometry.distances import FrameDistances
from riginv.geometry.kernels.library import kernels_for
from riginv.geometry.kinematics import remove_motion
from riginv.inference.bundle import RIG, Bundle, read_bundle
from riginv.networks.inverse import InverseNetwork, StagedInverse
from riginv.networks.packed import PackedInverse
from riginv.rig.black_box import BlackBoxRig
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.rig.sparse_basis import MESHES_OF_THREAD
from riginv.rig.sparse_encoder import SparseEncoder
from riginv.runs.threads import workers
from riginv.solvers.every_mesh import mean_distance_steps, refine_meshes
from riginv.solvers.fewer_controls import with_fewer_controls
from riginv.solvers.objective import Objective


class QuickEncoder(nn.Module):
    """As `MeshSpace.encode`, several times as fast on a CPU: by way of a sparse basis, or in bfloat16.

    Where a basis is not sparse, a CPU that multiplies bfloat16 does that: displacements are rounded by 1 part in 256 each,
    which leaves mesh coordinates within 0.2 % of their size: enough for a network, not for a solver or a mesh that moves by
    metres.

    Args:
        rig: in mesh space.
        rounded: whether rounding to bfloat16 is allowed.
    """

    def __init__(self, rig: RigInMeshSpace, rounded: bool = True) -> None:
        super().__init__()
        self.rig = [rig]  # in a list: its tensors are not this module's
        self.rounded = rounded

    @functools.cached_property
    def sparse(self) -> SparseEncoder | None:
        """The encoder by way of the basis; None where it is not for the rig."""
        return SparseEncoder.for_rig(self.rig[0])

    @functools.cached_property
    def frame(self) -> Tensor | None:
        """The directions in bfloat16; None where nothing is rounded."""
        directions = self.rig[0].space.directions
        quick = self.rounded and directions.device.type == "cpu" and _multiplies_bfloat16()
        return directions.flatten(1).bfloat16() if quick else None

    def forward(self, vertices: Tensor, motion: Tensor | None = None) -> Tensor:
        """Meshes `(batch, vertex, 3)`, mm, to mesh coordinates `(batch, coordinate)`.

        Args:
            motion: rigid motions `(batch, 4, 4)` that are removed first; None: there are none.
        """
        space = self.rig[0].space
        if kernels_for(vertices) is not None and vertices.dtype == torch.float32 and self.sparse is not None:
            return self.sparse(space.rest_vertices, vertices, motion)
        vertices = vertices if motion is None else remove_motion(motion, vertices)
        if vertices.device.type != "cpu" or self.frame is None:
            return space.encode(vertices)
        return ((vertices - space.rest_vertices).flatten(1).bfloat16() @ self.frame.T).to(vertices.dtype)

    def compare(
        self, vertices: Tensor, motion: Tensor | None, coefficients: Tensor
    ) -> tuple[Tensor, FrameDistances, FrameDistances] | None:
        """`SparseEncoder.compare`; None where there is no sparse basis or no kernel for the meshes."""
        if kernels_for(vertices, coefficients) is None or vertices.dtype != torch.float32 or self.sparse is None:
            return None
        return self.sparse.compare(self.rig[0].space.rest_vertices, vertices, motion, coefficients)


def _multiplies_bfloat16() -> bool:
    is_supported = getattr(torch.cpu, "_is_avx512_bf16_supported", None)  # not public: a later version may lack it
    return is_supported is not None and is_supported()


# Weights without these are of a network that was made without the option, also where the rig has features now.
MADE_WITH = (
    ("features", False, "features.scale"),
    ("preconditioned", False, "preconditioner.matrix"),
    ("weighted_steps", 0, "weights.frame"),
    ("distance_steps", 0, "quasi_newton.distance.frame"),
    ("quasi_newton_steps", 0, "quasi_newton.hessian"),
)
FIRST_LAYER = "stages.0.network.0.weight"  # its inputs are the mesh coordinates that a network sees, where it has no features
MIN_SIZE_FOR_BFLOAT16 = 1_000_000  # numbers of a frame: below it there is nothing to gain


class Inverse(nn.Module):
    """Maps meshes to the controls of a rig.

    Args:
        refine: steps of Levenberg-Marquardt that follow the network, mesh by mesh.
        trained_seconds: the duration of its training, s.
        fewer_controls: whether controls that the mesh does not need are set to neutral (`with_fewer_controls`).
        mean_steps: steps on the mean vertex distance that follow the network (`mean_distance_steps`), instead of `refine`.

    Attributes:
        network: from mesh coordinates to controls; holds its rig and its mesh space.
    """

    def __init__(
        self,
        network: InverseNetwork,
        refine: int = 0,
        trained_seconds: float = 0.0,
        fewer_controls: bool = False,
        mean_steps: int = 0,
    ) -> None:
        super().__init__()
        if mean_steps and (refine or fewer_controls):
            raise InputError(f"mean_steps={mean_steps} is for the network alone: leave out refine and fewer_controls")
        self.mean_steps = mean_steps
        self.network, self.refine, self.trained_seconds = network, refine, trained_seconds
        self.fewer_controls = fewer_controls
        is_large = network.rig.space.directions.numel() >= MIN_SIZE_FOR_BFLOAT16
        self.encoder = QuickEncoder(network.rig, rounded=network.rig.source.has_blendshapes and is_large)

    @property
    def rig(self) -> LinearRig:
        return self.network.rig.source

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
        if not (self.refine or self.fewer_controls or self.mean_steps):
            return self._by_network(vertices)
        coordinates = space.encode(vertices)
        controls = self.answer(coordinates)
        if self.mean_steps:
            return self.after_mean_steps(coordinates, controls, self.mean_steps)
        start = self.objective.units(controls)
        found = refine_meshes(self.objective, coordinates, start, self.refine).units
        if self.fewer_controls:
            found = with_fewer_controls(self.objective, coordinates, found)
        return self.objective.to_controls(found)

    def _by_network(self, vertices: Tensor) -> Tensor:
        """The network's controls for meshes; those of many meshes by two threads."""
        if self.packed is None or len(vertices) < 2 * MESHES_OF_THREAD or torch.get_num_threads() == 1:
            return self.answer(self.encoder(vertices))
        _ = self.encoder.sparse  # before threads use it
        halves = vertices.split(-(-len(vertices) // 2))
        return torch.cat(workers().run([functools.partial(self._by_network, half) for half in halves]))

    @torch.no_grad()
    def answer(self, coordinates: Tensor) -> Tensor:
        """The network's controls `(batch, control)` for mesh coordinates `(batch, coordinate)`, without a graph."""
        found = None if self.packed is None else self.packed(coordinates)
        return self.network(coordinates) if found is None else found

    @property
    def has_distance_steps(self) -> bool:
        """Whether the network ends in steps on the mean distance."""
        return isinstance(self.network, StagedInverse) and self.network.has_distance_steps

    def after_distance_steps(self, coordinates: Tensor, controls: Tensor, steps: int) -> Tensor:
        """Controls `(batch, control)` after so many of these steps, without a graph."""
        packed = None if kernels_for(coordinates) is None else self.packed
        method = cast(StagedInverse, self.network) if packed is None else packed
        return method.after_distance_steps(coordinates, controls, steps)

    @functools.cached_property
    def packed(self) -> PackedInverse | None:
        """The network with its weights of the first use, for a CPU; None where there is none, or where it is still trained."""
        is_trained = any(weights.requires_grad for weights in self.network.parameters())
        return None if is_trained else PackedInverse.of(self.network)

    @torch.no_grad()
    def after_mean_steps(self, coordinates: Tensor, controls: Tensor, steps: int, fixed: Tensor | None = None) -> Tensor:
        """The network's controls `(batch, control)` after `mean_distance_steps`."""
        objective = self.plain_objective
        return objective.to_controls(mean_distance_steps(objective, coordinates, objective.units(controls), steps, fixed))

    @functools.cached_property
    def plain_objective(self) -> Objective:
        """The distance alone, without a prior, created on first use."""
        return Objective(self.network.rig, prior=0.0)

    @functools.cached_property
    def objective(self) -> Objective:
        """The objective of refinement, created on first use, on the network's device."""
        return Objective(self.network.rig)


def load_inverse(
    folder: str | Path,
    rig: RigBackend | None = None,
    refine: int = 0,
    fewer_controls: bool = False,
    mean_steps: int = 0,
) -> Inverse:
    """Load the inverse of a bundle.

    Args:
        folder: the bundle, or the run that holds it.
        rig: the rig, for one that is not part of riginv; else the bundle's own description builds it. An inverse that was
            trained through a surrogate contains the surrogate; `rig` is then only compared with it.
        refine: steps of Levenberg-Marquardt that follow the network, through the rig that it was trained on.
        fewer_controls: whether controls that the mesh does not need are set to neutral afterwards.
        mean_steps: steps on the mean vertex distance that follow the network, instead of `refine`.

    Raises:
        InputError: the bundle is missing, damaged, of another type or made for another rig.
    """
    bundle = read_bundle(folder, kind="inverse")
    if rig is not None:
        bundle.check_rig(rig)
    if rig is None or bundle.holds_surrogate:
        rig = bundle_rig(bundle)
        bundle.check_rig(rig)
    space = MeshSpace(bundle.space["rest_vertices"], bundle.space["frame"])
    if not isinstance(rig, LinearRig):
        rig = BlackBoxRig(rig, (bundle.space["linear_map"] @ space.directions.flatten(1)).unflatten(1, rig.rest_vertices.shape))
    made_with = _made_with(bundle) if _is_staged(bundle) else {}
    network = build({**bundle.description["network"], **made_with}, RigInMeshSpace(rig, space), kind=InverseNetwork, only=OURS)
    network.load_own_weights(bundle.weights)
    trained_seconds = float(bundle.description["training"].get("seconds", 0.0))
    return Inverse(network, refine, trained_seconds, fewer_controls, mean_steps).eval().requires_grad_(False)


def _is_staged(bundle: Bundle) -> bool:
    return class_of(bundle.description["network"].get("_target_"), kind=InverseNetwork, only=OURS) is StagedInverse


def _made_with(bundle: Bundle) -> dict[str, object]:
    """The options of a staged network that its weights tell."""
    options: dict[str, object] = {option: off for option, off, weights in MADE_WITH if weights not in bundle.weights}
    first = bundle.weights.get(FIRST_LAYER)
    if first is not None and "features" in options:
        options["coordinates"] = first.shape[1]
    return options


def bundle_rig(bundle: Bundle) -> RigBackend:
    """The rig that a bundle describes: one of riginv, or the surrogate in the bundle."""
    own = {"bundle": str(bundle.folder / RIG)} if bundle.holds_surrogate else {}
    return build({**bundle.description["rig"]["config"], **own}, kind=RigBackend, only=OURS)
