"""What files hold, as rows of a table: takes and maps of markers, skeletons, curves, recordings, bundles and priors."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from riginv.clips.bones import BoneMotion
from riginv.clips.control_curves import Curves
from riginv.clips.description import span_of
from riginv.clips.description_text import cell_of, frames_text
from riginv.clips.live_link import Recording
from riginv.clips.markers import MarkerClip
from riginv.errors import counted
from riginv.inference.bundle import read_bundle
from riginv.rig.interface import LinearRig
from riginv.rig.size import extent
from riginv.tracking.markers.map_file import markers_in
from riginv.tracking.priors.files import read_prior

Row = tuple[str, str]


def marker_rows(clip: MarkerClip, names: int | None) -> list[Row]:
    """The contents of a take of markers, as table rows."""
    known = np.isfinite(clip.points).all(axis=2)
    gaps = [f"{name} ({1 - seen:.0%})" for name, seen in zip(clip.names, known.mean(axis=0)) if seen < 1]
    size = np.ptp(clip.points[known], axis=0) if known.any() else np.zeros(3)
    return [
        ("format", clip.facts.format),
        ("markers", f"{len(clip.names):,}: {cell_of(list(clip.names), names)}"),
        ("frames", frames_text(span_of(clip.frame_numbers))),
        ("rate", f"{clip.fps:g} frames a second ({clip.facts.rate_source})" if clip.fps else "not known"),
        ("size", extent((size * (clip.unit_mm or 1.0)).tolist(), "" if clip.unit_mm else "units") + ", over all frames"),
        ("unit", f"{clip.unit_mm:g} mm" if clip.unit_mm else "not known"),
        ("up", clip.up or "not known"),
        ("gaps", f"{counted(len(gaps), 'marker')}: {cell_of(gaps, names)}" if gaps else "none"),
    ]


def skeleton_rows(motion: BoneMotion, names: int | None) -> list[Row]:
    """The contents of a file with the motion of a skeleton alone, as table rows."""
    moved = motion.positions[:, 0].numpy()
    return [
        ("format", "BVH: the motion of a skeleton, without meshes; rigs with joints of these names play it (rig=NAME)"),
        ("joints", f"{len(motion.names):,}: {cell_of(list(motion.names), names)}"),
        ("frames", frames_text(span_of(np.arange(len(moved))))),
        ("rate", f"{motion.fps:g} frames a second (its frame time)"),
        ("size", extent(np.ptp(motion.heads.numpy(), axis=0).tolist(), "units") + ", of the joints at rest"),
        ("root", f"moves over {extent(np.ptp(moved, axis=0).tolist(), 'units')}"),
    ]


def curve_rows(curves: Curves, names: int | None) -> list[Row]:
    """The contents of a file of curves of a rig's controls, as table rows.

    Raises:
        InputError: a value is no finite number.
    """
    controls = curves.names or [f"control {number}" for number in range(1, curves.values.shape[1] + 1)]
    for column, name in enumerate(controls):
        curves.check_column(column, name)
    motion = None if curves.motion is None else np.ptp(curves.motion, axis=0).reshape(2, 3).max(axis=1)
    return [
        ("format", f"{curves.format}: controls of a rig, without meshes"),
        ("rig", curves.rig or "not stated"),
        ("frames", frames_text(span_of(curves.frame_numbers))),
        ("rate", f"{curves.fps:g} frames a second ({curves.rate_source})" if curves.fps else "not known"),
        ("controls", f"{len(controls):,}" + ("" if curves.names else ", without names")),
        *range_rows("controls", controls, curves.values, names),
        ("rigid motion", "none" if motion is None else f"over {motion[0]:.3g} mm and {motion[1]:.3g} degrees, at most"),
    ]


def range_rows(what: str, columns: Sequence[str], values: np.ndarray, names: int | None) -> list[Row]:
    """The columns of values `(frame, column)` that move, with their ranges, and those that do not."""
    least, most = values.min(axis=0), values.max(axis=0)
    order = np.argsort(least - most, kind="stable").tolist()
    moving = [f"{columns[row]} ({least[row]:.2g} to {most[row]:.2g})" for row in order if most[row] > least[row]]
    still = [columns[row] for row in order if most[row] == least[row]]
    return [
        (f"{what} that move", f"{len(moving):,}: {cell_of(moving, names)}" if moving else "none: it never moves"),
        (f"{what} that do not", f"{len(still):,}: {cell_of(still, names)}" if still else "none"),
    ]


def recording_rows(recording: Recording, names: int | None) -> list[Row]:
    """The contents of a Live Link Face recording, as table rows."""
    count = len(recording.weights)
    return [
        ("format", "Live Link Face CSV"),
        ("rows", f"{count:,}"),
        ("columns", f"{len(recording.names):,} shapes"),
        ("rate", f"{recording.fps:g} frames a second"),
        ("length", f"{(count - 1) / recording.fps:.4g} s"),
        *range_rows("shapes", recording.names, recording.weights.numpy(), names),
    ]


def bundle_rows(path: Path, names: int | None) -> list[Row]:
    """The contents of a bundle, or of the run that holds it, as table rows."""
    bundle = read_bundle(path)
    rig, training = bundle.description["rig"], bundle.description["training"]
    controls = [control.name for control in bundle.controls]
    kind = {"inverse": "inverse: meshes to controls", "forward": "surrogate: controls to meshes"}[bundle.description["kind"]]
    return [
        ("bundle", kind),
        ("rig", f"{rig['name']}, {len(bundle.space['rest_vertices']):,} vertices ({rig['config'].get('_target_', '')})"),
        ("controls", f"{len(controls):,}: {cell_of(controls, names)}"),
        ("network", str(bundle.description["network"].get("_target_", ""))),
        ("mesh space", f"{len(bundle.space['frame']):,} coordinates"),
        ("training", ", ".join(f"{key} {value}" for key, value in training.items())),
    ]


def mesh_rows(meshes: Sequence[tuple[str, int, int]], names: int | None) -> list[Row]:
    """The meshes of a file, each with its vertices and its frames, as table rows: those that move first."""
    moving = sum(frames > 1 for _, _, frames in meshes)
    order = sorted(meshes, key=lambda mesh: mesh[2] <= 1)
    shown = order if names is None else order[:names]
    rows = [("meshes", f"{len(meshes):,}, of which {moving:,} move")]
    rows += [(name, f"{size:,} vertices, {f'{frames:,} frames' if frames > 1 else 'still'}") for name, size, frames in shown]
    return [
        *rows,
        *([("...", f"{len(meshes) - len(shown):,} more (verbose=true names all)")] if len(shown) < len(meshes) else []),
    ]


def prior_rows(folder: Path, rig: LinearRig | None, names: int | None) -> list[Row]:
    """The contents of a prior of `riginv.learn_prior`, as table rows.

    Args:
        rig: that it should be of; None: any.

    Raises:
        InputError: it is damaged, or of another rig.
    """
    facts, prior = read_prior(folder, rig)
    order = np.argsort(-prior.deviation.numpy(), kind="stable").tolist()
    freest = [f"{prior.names[row]} ({float(prior.deviation[row]):.2g})" for row in order]
    return [
        ("prior", "which controls of a rig occur together: riginv.invert takes it with prior=PATH"),
        ("rig", str(facts["rig"].get("name", ""))),
        ("controls", f"{len(prior.names):,}"),
        ("learned from", f"{prior.source}; {facts.get('frames', 0)} frames"),
        ("changes", "from frame to frame, too" if prior.changes is not None else "not known: learned by an earlier version"),
        ("free to move", f"{cell_of(freest, names)}; standard deviations, in fractions of the ranges"),
    ]


def map_rows(path: Path, names: int | None) -> list[Row]:
    """The contents of a map of markers or landmarks, as table rows.

    Raises:
        InputError: it is damaged.
    """
    rig, markers = markers_in(path)
    offsets = sum(isinstance(place, dict) and place.get("offset_mm") is not None for place in markers.values())
    points = sum(isinstance(place, dict) and "point" in place for place in markers.values())
    return [
        ("map", "where markers are on a rig: correspondence=markers markers=PATH, or landmarks.map=PATH of scans"),
        ("rig", "not stated" if rig is None else str(rig)),
        ("markers", f"{len(markers):,}: {cell_of([str(name) for name in markers], names)}"),
        ("offsets", f"{offsets:,} given, {len(markers) - offsets:,} to be calibrated"),
        ("points", f"{points:,} with a position in a scan" if points else "none"),
    ]
