"""A layout of markers: the points of a rig's skin that determine its whole mesh best."""

import numpy as np
import torch
from torch import Tensor

from riginv.rig.interface import LinearRig
from riginv.tracking.markers.placement import Placement, at_vertices
from riginv.tracking.priors.prior import ControlPrior
from riginv.tracking.regions import label, regions_of
from riginv.tracking.surfaces.rig_surface import EXPOSED, exposure
from riginv.tracking.surfaces.wrap import skin_component

CANDIDATES = 3000  # vertices of the skin that are tried, at most
OPEN = 0.5  # fraction of unoccluded rays at a vertex that a marker can be glued to
NOISE_MM = 0.15  # of a marker while places are chosen; half of a real one: see docs/experiments.md#markers
UNMARKABLE = 0.3  # fraction of a control's squared displacement on the skin, below which markers do not see it
SPACING = 0.02  # least distance of two markers, relative to the rig's size
POSES = 6  # about which the rig is taken as linear


@torch.no_grad()
def suggest_layout(rig: LinearRig, prior: ControlPrior, count: int, noise_mm: float, offset_mm: float | None) -> Placement:
    """Markers at vertices, chosen one by one: each reduces the variance of the whole mesh most (A-optimal design).

    The variance is that of the prior's Gaussian after markers of some noise, summed over linear models of the rig about the
    prior's mean and random poses.

    Args:
        count: of markers, fewer where they would be nearer to each other than `SPACING`.
        offset_mm: of the markers from the skin; None: to be calibrated.
    """
    rest, faces = rig.rest_vertices.cpu().double().numpy(), rig.faces.cpu().numpy()
    outer = marker_skin(rest, faces)
    some = torch.from_numpy(outer[:: -(-len(outer) // CANDIDATES)])
    root = torch.linalg.cholesky(prior.covariance)
    models = [_Linear(rig, units, root, some, noise_mm) for units in _poses(prior.mean, root)]
    places, spacing_mm = rig.rest_vertices[some], SPACING * float(np.ptp(rest, axis=0).max())
    chosen, too_near = list[int](), torch.zeros(len(some), dtype=torch.bool)
    while len(chosen) < count and not too_near.all():
        gain = torch.stack([model.gain() for model in models]).sum(dim=0).where(~too_near, -1.0)
        best = int(gain.argmax())
        chosen.append(best)
        too_near |= (places - places[best]).norm(dim=1) < spacing_mm
        for model in models:
            model.add(best)
    vertices = some[chosen].tolist()
    return at_vertices(rig, _names(rig, vertices), vertices, offset_mm)


def _poses(mean: Tensor, root: Tensor) -> Tensor:
    """A prior's mean and random poses of it `(pose, control)`, from a Cholesky factor of its covariance."""
    draws = torch.randn(POSES - 1, len(mean), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return torch.cat([mean[None], (mean + draws @ root.T).clamp(0, 1)])


class _Linear:
    """What markers tell of a rig that is linear about a pose.

    Args:
        units: the pose, `(control,)`, as fractions of the ranges.
        root: a Cholesky factor of the prior's covariance.
        some: vertices that may carry a marker.
        noise_mm: of a marker.
    """

    def __init__(self, rig: LinearRig, units: Tensor, root: Tensor, some: Tensor, noise_mm: float) -> None:
        span = rig.upper - rig.lower
        _, jacobian = rig.coefficient_jacobian((rig.lower + span * units.to(span))[None])
        columns = rig.basis.flatten(1).T.double() @ (jacobian.dense()[0].double() @ (span[:, None].double() * root))
        self.here = columns.unflatten(0, (-1, 3))[some]
        self.half = self.here.clone()  # times the variance of the controls given the markers so far: at first 1
        self.reach = self.half @ (columns.T @ columns)  # their covariances with the whole mesh, times its own displacements
        self.noise = noise_mm**2 * torch.eye(3, dtype=torch.float64)

    def gain(self) -> Tensor:
        """By how much a marker at each vertex reduces the variance of the whole mesh, `(vertex,)`, mm^2."""
        measured = self.half @ self.here.mT + self.noise
        return torch.linalg.solve(measured, self.reach @ self.half.mT).diagonal(dim1=1, dim2=2).sum(dim=1)

    def add(self, vertex: int) -> None:
        """Put a marker at a vertex."""
        half, reach = self.half[vertex].clone(), self.reach[vertex].clone()
        share = torch.linalg.solve(half @ self.here[vertex].T + self.noise, self.here @ half.T, left=False)
        self.half -= share @ half
        self.reach -= share @ reach


@torch.no_grad()
def unmarkable_controls(rig: LinearRig, units: Tensor) -> Tensor:
    """Which controls move mostly what no marker can be glued to, such as gaze and tongue, `(control,)`.

    Args:
        units: controls about which they move, as fractions of their ranges, `(control,)`.
    """
    skin = torch.from_numpy(marker_skin(rig.rest_vertices.cpu().double().numpy(), rig.faces.cpu().numpy()))
    span = rig.upper - rig.lower
    _, jacobian = rig.coefficient_jacobian((rig.lower + span * units.to(span))[None])
    moved = jacobian.dense()[0]  # (coefficient, control)
    every, outer = ((basis.flatten(1).T @ moved).square().sum(dim=0) for basis in (rig.basis, rig.basis[:, skin]))
    return (outer < UNMARKABLE * every).cpu()


def marker_skin(rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Indices of vertices that a marker can be glued to: exposed skin, no eyeballs, teeth or inner mouth."""
    exposed = exposure(rest, faces)
    outer = np.flatnonzero(exposed > EXPOSED)
    found = np.flatnonzero(skin_component(rest, faces, outer if len(outer) else np.arange(len(rest))) & (exposed > OPEN))
    return found if len(found) else np.arange(len(rest))


def _names(rig: LinearRig, vertices: list[int]) -> list[str]:
    """Names by region, such as `mouth03`; without regions `m03`."""
    labels, counts = label(regions_of(rig), len(rig.rest_vertices)), dict[str, int]()
    names = []
    for vertex in vertices:
        region = labels[vertex] or "m"
        counts[region] = counts.get(region, 0) + 1
        names.append(f"{region}{counts[region]:02d}")
    return names
