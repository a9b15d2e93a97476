"""A linear change of a network's raw outputs in which the error of a mesh is curved about equally in all directions.

A degree of the spine moves a hundred times as much of the mesh as one of a finger, and whatever turns a joint moves all that
hangs on it. So the steps of a learned optimiser differ in size by orders of magnitude and depend on each other; in these
coordinates a Gauss-Newton step is near the negative gradient, on average over poses (docs/experiments.md).
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.networks.control_maps import ControlMap
from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.random_controls import sparse_controls

SKIN_SIZE_MM = 10.0  # the root mean square displacement of the vertices by a step of length 1, where a rig has features
SIZE = 0.004  # the same for other rigs, as a fraction of the mesh's diagonal
DAMPING = 0.3  # of the Hessian with a unit diagonal: for controls without effect, and those that do the same
LEAST, TINY = 1e-9, 1e-9  # lower bounds of the diagonal: of its greatest element, and of that
MESHES, BATCH_SIZE = 128, 64  # that the Hessian is a mean over: some rigs take 0.1 s for each; BATCH_SIZE bounds the memory
STRENGTH = 0.5  # of the random controls that it is computed at, where there is no guess


class Preconditioner(nn.Module):
    """From raw outputs to the coordinates of steps, and back.

    With H the mean Gauss-Newton Hessian of half the squared error by the raw outputs, D its diagonal and S = D^-1/2 H D^-1/2,
    a step u changes the raw outputs by A u, A = s D^-1/2 (S + damping)^-1/2. The gradient g of a mesh becomes A^T g / s^2, the
    negative of a Gauss-Newton step with H.

    Args:
        rig: in mesh space.
        has_features: whether the network uses the rig's features.
    """

    matrix: Tensor

    def __init__(self, rig: RigInMeshSpace, has_features: bool) -> None:
        super().__init__()
        count = len(rig.source.controls)
        self.register_buffer("matrix", torch.eye(count).to(rig.linear_map))
        rest = rig.space.rest_vertices
        size = SKIN_SIZE_MM if has_features else SIZE * float((rest.amax(dim=0) - rest.amin(dim=0)).norm())
        self.squared_size = rig.space.vertex_count * size**2

    @torch.no_grad()
    def calibrate(self, rig: RigInMeshSpace, control_map: ControlMap, raw: Float[Tensor, "batch control"]) -> None:
        """Set the matrix from the Hessians at raw outputs `(batch, control)`."""
        raw = raw[:MESHES]
        sums = [len(batch) * mean_hessian(rig, control_map, batch) for batch in raw.split(BATCH_SIZE)]
        hessian = torch.stack(sums).sum(dim=0) / len(raw)
        diagonal = hessian.diagonal()
        sizes = diagonal.clamp_min(LEAST * max(float(diagonal.max()), TINY)).sqrt()
        values, vectors = torch.linalg.eigh(hessian / sizes[:, None] / sizes)
        root = (vectors * (values.clamp_min(0) + DAMPING).rsqrt()) @ vectors.T
        self.matrix.copy_(self.squared_size**0.5 * root / sizes[:, None])

    def gradient(self, gradient: Float[Tensor, "batch control"]) -> Float[Tensor, "batch control"]:
        """The gradient by steps, scaled, of one by raw outputs, both `(batch, control)`."""
        return gradient @ self.matrix / self.squared_size

    def step(self, step: Float[Tensor, "batch control"]) -> Float[Tensor, "batch control"]:
        """The change of the raw outputs by a step, both `(batch, control)`."""
        return step @ self.matrix.T


def weak_poses(rig: LinearRig) -> Float[Tensor, "mesh control"]:
    """Random controls at `STRENGTH` of their distance from neutral, `(MESHES, control)`, where the Hessian is typical."""
    limits = rig.lower, rig.upper, rig.neutral_controls
    generator = generator_at(0, "weak poses", device=rig.lower.device)
    controls = sparse_controls(*limits, len(rig.controls), MESHES, generator)
    return rig.neutral_controls + STRENGTH * (controls - rig.neutral_controls)


def mean_hessian(
    rig: RigInMeshSpace, control_map: ControlMap, raw: Float[Tensor, "batch control"]
) -> Float[Tensor, "control control"]:
    """The mean Gauss-Newton Hessian of half the squared error by raw outputs `(batch, control)`, in float64."""
    controls, to_raw = control_map.with_vjp(raw)
    derivatives = to_raw(torch.ones_like(controls))
    hessians = rig.source.coefficient_jacobian(controls)[1].gram(rig.linear_map @ rig.linear_map.T)
    return (derivatives[:, :, None] * hessians * derivatives[:, None]).double().mean(dim=0)
