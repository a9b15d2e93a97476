"""A map of markers proposed from one frame: the rig is aligned with the markers, and each goes to the nearest point."""

from typing import NamedTuple

import numpy as np
import torch

from riginv.rig.interface import LinearRig
from riginv.solvers.levenberg_marquardt import levenberg_marquardt
from riginv.tracking.constraints import resolve_constraints
from riginv.tracking.markers.assembly import build_objective
from riginv.tracking.markers.layout import marker_skin
from riginv.tracking.markers.objective import pack
from riginv.tracking.markers.placement import Placement
from riginv.tracking.options import ControlOptions, TrackingOptions
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.surfaces.alignment import right_angles
from riginv.tracking.surfaces.motion import Motion, fit_motion
from riginv.tracking.surfaces.rig_surface import farthest_points
from riginv.tracking.surfaces.triangles import Hits, TriangleMesh
from riginv.tracking.surfaces.wrap import connected_parts

ROUNDS, MORE_ROUNDS = (4, 4), (4, 20)  # of closest points, for each start and for the best ones
RIDGE = 0.01  # on the common height, relative to one marker's distance
PLACES, FINALISTS = 24, 12  # of the skin, near which the markers may be; starts that are refined further
BETTER = 0.8  # factor of the distance that a rotated start must reach
POSE_ROUNDS, POSE_STEPS, POSE_NOISE_MM = 5, 10, 10.0
AROUND, TOO_LOW = 2.0, 0.3  # of the common height: the surface near a marker; how much lower one is that may belong elsewhere
NEARLY = 1.25  # factor of the distance up to which another alignment is as good


class Proposal(NamedTuple):
    """A proposed map.

    Attributes:
        placement: of the markers; offsets as measured in the frame.
        distance_mm: of each marker from the rig's surface, `(marker,)`.
        rivals: number of other alignments, turned by a right angle or more, that fit nearly as well.
    """

    placement: Placement
    distance_mm: np.ndarray
    rivals: int


def propose(
    rig: LinearRig, names: tuple[str, ...], points: np.ndarray, anchors: Placement | None, with_pose: bool, calibrated: bool
) -> Proposal:
    """The nearest points of a rig to the markers of a frame.

    Args:
        points: of the frame, `(marker, 3)`, mm.
        anchors: known places of three markers or more, which give the alignment; None: it is searched for.
        with_pose: whether controls are fitted, too, for a frame that is not in the rig's neutral pose.
        calibrated: whether offsets are left to be calibrated from the clip.
    """
    rest, faces = rig.rest_vertices.cpu().double().numpy(), rig.faces.cpu().numpy()
    outer = marker_skin(rest, faces)
    skin = faces[np.isin(faces, outer).all(axis=1)]
    mesh, rivals = TriangleMesh(rest, skin), 0
    if anchors is None:
        motion, rivals = _align(mesh, rest[outer], points)
    else:
        rows = [names.index(name) for name in anchors.names]
        motion = fit_motion(anchors.points(rig.rest_vertices).cpu().double().numpy(), points[rows], np.ones(len(rows)))
    hits = mesh.closest(motion.undo(points))
    if with_pose:
        hits, motion, mesh = _pose(rig, names, points, skin, hits)
    local = motion.undo(points)
    hits = at_common_height(mesh, local, hits)
    height = ((local - hits.points) * _face_normals(mesh, hits)).sum(axis=1)
    weights = torch.from_numpy(hits.barycentric).float()
    free = torch.full((len(names),), calibrated)
    placement = Placement(names, torch.from_numpy(hits.corners), weights, torch.from_numpy(height).float(), free)
    return Proposal(placement, hits.distance, rivals)


def at_common_height(mesh: TriangleMesh, local: np.ndarray, hits: Hits) -> Hits:
    """The closest points, of the other lip or lid where the markers' common height fits that and not the nearest one.

    Args:
        local: markers in the mesh's frame, `(marker, 3)`.
    """
    result = Hits(*(values.copy() for values in hits))
    height = ((local - hits.points) * hits.normals).sum(axis=1)
    common = float(np.median(height))
    for marker in np.flatnonzero((height > 0) & (height < (1 - TOO_LOW) * common)):
        near = np.linalg.norm(mesh.points - local[marker], axis=1) < AROUND * common
        faces = mesh.faces[near[mesh.faces].any(axis=1)]
        part = connected_parts(faces, len(near))
        for other in np.setdiff1d(part[faces[:, 0]], part[hits.corners[marker]]):
            found = TriangleMesh(mesh.points, faces[part[faces[:, 0]] == other]).closest(local[marker : marker + 1])
            above = float(((local[marker] - found.points[0]) * found.normals[0]).sum())
            if abs(above - common) < BETTER * abs(float(height[marker]) - common):
                for mine, theirs in zip(result, found):
                    mine[marker] = theirs[0]
    return result


def _face_normals(mesh: TriangleMesh, hits: Hits) -> np.ndarray:
    first, second, third = np.moveaxis(mesh.points[hits.corners], 1, 0)
    normals = np.cross(second - first, third - first)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _align(mesh: TriangleMesh, outer: np.ndarray, points: np.ndarray) -> tuple[Motion, int]:
    """The best alignment of all starts, and the number of rivals.

    The starts put the middle of the markers near places of the skin, in all rotations by right angles.
    """
    places, middle, tried = outer[farthest_points(outer, PLACES)], points.mean(axis=0), []
    for number, rotation in enumerate(right_angles()):
        for place in places:
            start = Motion(rotation, middle - rotation @ place)
            motion, spread = _refined(mesh, start, points, ROUNDS)
            tried.append((spread / (1.0 if number == 0 else BETTER), spread, motion))
    tried.sort(key=lambda one: one[0])
    refined = [_refined(mesh, motion, points, MORE_ROUNDS) for _, _, motion in tried[:FINALISTS]]
    best, least = min(refined, key=lambda one: one[1])
    return best, sum(_angle(motion, best) > 30 and spread < NEARLY * max(least, 1e-9) for motion, spread in refined)


def _refined(mesh: TriangleMesh, motion: Motion, points: np.ndarray, rounds: tuple[int, int]) -> tuple[Motion, float]:
    """Iterated closest points on the skin at one height, and the mean deviation from that height.

    Args:
        rounds: point to point, and point to plane.
    """
    common = 0.0
    for number in range(sum(rounds)):
        hits, height = _heights(mesh, motion.undo(points))
        if number < rounds[0]:
            common = max(float(np.median(height)), 0.0)
            motion = fit_motion(hits.points + common * hits.normals, points, np.ones(len(points)))
        else:
            motion, common = _plane_step(hits, points, motion, common)
    _, height = _heights(mesh, motion.undo(points))
    return motion, float(np.abs(height - common).mean())


def _plane_step(hits: Hits, points: np.ndarray, motion: Motion, common: float) -> tuple[Motion, float]:
    """A step of least squares of the distances along the normals from one height, in rigid motion and that height."""
    local = motion.undo(points)
    centre = local.mean(axis=0)
    residual = ((local - hits.points) * hits.normals).sum(axis=1) - common
    rows = np.concatenate([-np.cross(local - centre, hits.normals), -hits.normals, -np.ones((len(points), 1))], axis=1)
    square = rows.T @ rows + RIDGE * np.diag([0.0] * 6 + [1.0])
    change = np.linalg.solve(square + 1e-9 * np.trace(square) * np.eye(7), -rows.T @ residual - RIDGE * common * np.eye(7)[6])
    return motion.after(change[:3], change[3:6], centre), max(common + float(change[6]), 0.0)


def _heights(mesh: TriangleMesh, local: np.ndarray) -> tuple[Hits, np.ndarray]:
    """Closest points, and the distances from these, `(marker,)`: negative inside."""
    hits = mesh.closest(local)
    return hits, hits.distance * np.where(((local - hits.points) * hits.normals).sum(axis=1) < 0, -1.0, 1.0)


def _angle(one: Motion, other: Motion) -> float:
    """Degrees between two rotations."""
    return float(np.degrees(np.arccos(np.clip((np.trace(one.rotation @ other.rotation.T) - 1) / 2, -1, 1))))


def _pose(
    rig: LinearRig, names: tuple[str, ...], points: np.ndarray, skin: np.ndarray, hits: Hits
) -> tuple[Hits, Motion, TriangleMesh]:
    """Controls and closest points, solved alternately: the closest points, the rigid motion, and the posed skin."""
    constraints, options = resolve_constraints(rig, ControlOptions()), TrackingOptions(noise_mm=POSE_NOISE_MM)
    prior, seen = default_prior(rig), pack(torch.from_numpy(points).to(rig.dtype)[None])
    units, motion, mesh = prior.mean.to(rig.dtype)[None], Motion.identity(), TriangleMesh(rig.rest_vertices.numpy(), skin)
    none = torch.zeros(len(names))
    for _ in range(POSE_ROUNDS):
        weights = torch.from_numpy(hits.barycentric).to(rig.dtype)
        placement = Placement(names, torch.from_numpy(hits.corners), weights, none, none > 0)
        objective = build_objective(rig, placement, constraints, prior, True, options)
        units = levenberg_marquardt(objective, seen, units, POSE_STEPS).units
        rotation, translation = objective.residuals(units, seen).motion
        motion = Motion(rotation[0].double().numpy(), translation[0].double().numpy())
        with torch.no_grad():
            mesh = TriangleMesh(rig(objective.all_controls(units))[0].double().numpy(), skin)
        hits = mesh.closest(motion.undo(points))
    return hits, motion, mesh
