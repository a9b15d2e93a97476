"""The neutral of an actor as given: a mesh of the rig's topology, a scan that is wrapped, or frames of the clip."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from riginv.clips.clip import Clip, frames_named
from riginv.clips.open import open_clip
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.sequence import ScansError
from riginv.clips.topology import TopologyError
from riginv.clips.units import ClipUnits
from riginv.errors import InputError
from riginv.geometry.kinematics import remove_motion
from riginv.rig.interface import RigBackend
from riginv.tracking.options import ActorOptions
from riginv.tracking.rigid import fit_rigid
from riginv.tracking.surfaces.landmark_files import landmarks_of_scan
from riginv.tracking.surfaces.landmarks import Landmarks
from riginv.tracking.surfaces.scan_files import holds_scans, read_scan
from riginv.tracking.surfaces.scans import Scan
from riginv.tracking.surfaces.wrap import wrap

FARTHEST = 0.25  # mean offset, relative to the mean distance of the rig's vertices from their centre
LEAST_USABLE = 0.5  # fraction of the rig's skin that a scan of a neutral must cover


class GivenNeutral(NamedTuple):
    """A neutral as given.

    Attributes:
        vertices: `(vertex, 3)`, mm, NaN where not known.
        source: what it is, in words.
        notes: sentences for the user.
        is_aligned: whether it is in the rig's space.
    """

    vertices: Tensor
    source: str
    notes: list[str]
    is_aligned: bool = False


def read_neutral(options: ActorOptions, rig: RigBackend, reading: ReadingOptions) -> GivenNeutral:
    """The neutral in a file: a mesh of the rig's topology, or a scan, which is wrapped, as what has landmarks is.

    Raises:
        InputError: it cannot be read, holds several meshes, has the rig's vertices in another order, or cannot be wrapped.
    """
    path = str(options.neutral)
    if options.landmarks or holds_scans(path):
        return _wrapped(path, rig, reading, options.landmarks)
    try:
        clip, notes = open_clip(path, rig, replace(reading, fps=reading.fps or 1.0), FrameOptions())
    except TopologyError as error:
        if error.same_count:
            raise InputError(f"actor.neutral={error}") from None
        return _wrapped(path, rig, reading)
    except ScansError:
        return _wrapped(path, rig, reading)
    if len(clip) != 1:
        raise InputError(
            f"actor.neutral={path}: {len(clip)} meshes, expected one (actor.neutral_frames names frames of the clip)"
        )
    found = clip.vertices(0, 1)[0]
    if not bool(torch.isfinite(found).all()):
        raise InputError(f"actor.neutral={path}: vertices that are not finite numbers: export it again")
    return GivenNeutral(found, Path(path).name, [f"actor.neutral: {note}" for note in notes])


def _wrapped(path: str, rig: RigBackend, reading: ReadingOptions, landmarks: str | None = None) -> GivenNeutral:
    scan, units = read_scan(path, reading, rig, "actor.neutral")
    known = landmarks_of_scan(landmarks, rig, scan.points, units)
    vertices, note = wrapped(scan, units, rig, f"actor.neutral={path}", known)
    return GivenNeutral(vertices, f"{Path(path).name}, wrapped", [note, *units.notes], True)


def wrapped(scan: Scan, units: ClipUnits, rig: RigBackend, key: str, landmarks: Landmarks | None) -> tuple[Tensor, str]:
    """A rig's mesh with the shape of a scan, in the rig's space, `(vertex, 3)`, mm, and a note.

    Args:
        key: the setting that names the scan, for messages.

    Raises:
        InputError: the scan cannot be brought onto the mesh, or covers less than half of it.
    """
    surface = scan.surface(units.mm, units.axes.double().numpy())
    try:
        found = wrap(rig.rest_vertices.cpu().numpy(), rig.faces.cpu().numpy(), surface, landmarks=landmarks)
    except InputError as error:
        raise InputError(f"{key}: {error}") from None
    if found.usable < LEAST_USABLE:
        raise InputError(
            f"{key}: only {found.usable:.0%} of the rig's skin lies on the scan, expected {LEAST_USABLE:.0%} or more: "
            f"give a scan of the whole face at rest"
        )
    note = f"{key}: a scan, wrapped: {found.usable:.0%} of the skin lies on it; {found.scale:.3g} times the rig's size"
    if landmarks is not None:
        note += f"; {landmarks.away_from(found.vertices)}"
    return torch.from_numpy(found.scale * found.local).to(rig.dtype), note


def in_rig_space(given: GivenNeutral, rest: Tensor, stability: Tensor, moves: bool) -> Tensor:
    """A given neutral in the rig's space, with the rig's vertices where it has none, `(vertex, 3)`.

    Args:
        rest: vertices of the rig.
        stability: of the vertices in the alignment, `(vertex,)`.
        moves: whether it may have a rigid motion, which is removed.

    Raises:
        InputError: it is far from the rig's shape.
    """
    neutral = given.vertices.to(rest)
    if moves and not given.is_aligned:
        neutral = remove_motion(fit_rigid(rest[None], neutral[None], stability), neutral[None])[0]
    neutral = torch.where(torch.isfinite(neutral).all(dim=1, keepdim=True), neutral, rest)
    size = float((rest - rest.mean(dim=0)).norm(dim=1).mean())
    distance = float((neutral - rest).norm(dim=1).mean())
    if distance > FARTHEST * size:
        raise InputError(
            f"actor.neutral: {given.source} lies {distance:.3g} mm from the rig on average, expected at most "
            f"{FARTHEST * size:.3g} mm: its vertices are in another order, or it is another mesh"
        )
    return neutral


def neutral_of_frames(clip: Clip, frames: list[int | str], stability: Tensor) -> GivenNeutral:
    """The mean of some frames of a clip, without rigid motion between them.

    Raises:
        InputError: a frame is not in the clip, or they have no known vertices.
    """
    rows = frames_named(clip.sequence.path, clip.frame_numbers, frames, "actor.neutral_frames").nonzero()[:, 0].tolist()
    meshes = torch.cat([clip.vertices(row, row + 1) for row in rows])
    known = torch.isfinite(meshes).all(dim=2)
    first = int(known.sum(dim=1).argmax())
    if int(known[first].sum()) < 3:
        raise InputError(f"actor.neutral_frames={frames}: no vertex of these frames of {clip.sequence.path} is known")
    motion = fit_rigid(meshes[first].nan_to_num(0.0)[None], meshes, stability * known[first])
    text = ", ".join(str(frame) for frame in frames)
    return GivenNeutral(remove_motion(motion, meshes).nanmean(dim=0), f"frames {text} of the clip", [])
