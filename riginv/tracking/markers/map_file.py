"""The map of markers to points of a rig's surface, as YAML; and its comparison with the names of a clip."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from riginv.clips.markers import MarkerClip
from riginv.clips.options import ReadingOptions
from riginv.errors import InputError, in_short, listed
from riginv.rig.interface import RigBackend
from riginv.runs.files import read_text, read_yaml, write_text
from riginv.tracking.markers.objective import FEWEST
from riginv.tracking.markers.placement import Placement, at_vertices

KEYS = ("vertex", "triangle", "barycentric", "offset_mm", "point")


def read_map(path: Path, rig: RigBackend) -> Placement:
    """The places of markers on a rig.

    Raises:
        InputError: the file is missing or damaged, names a marker twice, or a place that the rig does not have.
    """
    named, markers = markers_in(path)
    if named not in (None, rig.name):
        raise InputError(f"{path}: a map for rig '{named}', and this is rig '{rig.name}': make a map for it")
    places = [_place(f"{path}: marker {name!r}", place, rig) for name, place in markers.items()]
    names = tuple(str(name) for name in markers)
    corners, barycentric, offsets, calibrated = zip(*places)
    return Placement(names, torch.stack(corners), torch.stack(barycentric), torch.tensor(offsets), torch.tensor(calibrated))


def markers_in(path: Path) -> tuple[Any, dict[Any, Any]]:
    """The rig that a map names, or None, and the place of each of its markers as the file has it.

    Raises:
        InputError: the file is missing or damaged, or names a marker twice.
    """
    content = read_yaml(path)
    markers = content.get("markers")
    if not isinstance(markers, dict) or not markers:
        raise InputError(f"{path}: no markers in it, expected markers: with a name and a place each, as nose: {{vertex: 12}}")
    _check_names(path)
    return content.get("rig"), markers


def read_points(path: Path, names: Sequence[str]) -> np.ndarray:
    """The positions `point: [x, y, z]` of the markers of a map that `read_map` accepts, `(marker, 3)`.

    Raises:
        InputError: one has none.
    """
    markers = {str(name): place for name, place in read_yaml(path)["markers"].items()}
    for name in names:
        point = markers[name].get("point")
        if not (isinstance(point, list) and len(point) == 3 and all(_is_number(each) and abs(each) < 1e12 for each in point)):
            raise InputError(f"{path}: marker {name!r} has point {point!r:.60}, expected its position in the scan: [x, y, z]")
    return np.array([markers[name]["point"] for name in names], np.float64)


def _check_names(path: Path) -> None:
    """Raise InputError where a marker is there twice: YAML itself would keep the last."""
    try:
        document = yaml.compose(read_text(path), Loader=yaml.SafeLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read as YAML: {in_short(error)}") from None
    pairs = document.value if isinstance(document, yaml.MappingNode) else []
    inside = [value for key, value in pairs if key.value == "markers" and isinstance(value, yaml.MappingNode)]
    counts = Counter(str(key.value) for value in inside for key, _ in value.value)
    twice = [name for name, count in counts.items() if count > 1]
    if twice:
        raise InputError(f"{path}: marker {twice[0]!r} is there twice, expected each name once: remove one")


def _place(where: str, place: Any, rig: RigBackend) -> tuple[torch.Tensor, torch.Tensor, float, bool]:
    """Corners, barycentric weights, offset, and whether the offset is to be calibrated."""
    if not isinstance(place, Mapping) or set(place) - set(KEYS) or ("vertex" in place) == ("triangle" in place):
        raise InputError(
            f"{where} is {place!r:.80}, expected vertex: NUMBER, or triangle: [A, B, C] with barycentric: [a, b, c], "
            f"and perhaps offset_mm"
        )
    offset = place.get("offset_mm")
    if offset is not None and not (_is_number(offset) and abs(offset) <= 1000):
        raise InputError(f"{where} has offset_mm {offset!r:.40}, expected millimetres from -1000 to 1000, or null: calibrated")
    numbers = place["triangle"] if "triangle" in place else [place["vertex"]]
    last = len(rig.rest_vertices) - 1
    good = isinstance(numbers, list) and all(type(number) is int and 0 <= number <= last for number in numbers)
    if not good or len(numbers) != (3 if "triangle" in place else 1):
        raise InputError(f"{where} has {numbers!r:.60}, expected numbers of vertices from 0 to {last} of rig '{rig.name}'")
    if "vertex" in place:
        one = at_vertices(rig, [""], numbers, offset)
        return one.corners[0], one.barycentric[0], float(offset or 0.0), offset is None
    weights = place.get("barycentric", [1 / 3] * 3)
    if not isinstance(weights, list) or len(weights) != 3 or not all(_is_number(each) and -1 <= each <= 2 for each in weights):
        raise InputError(f"{where} has barycentric {weights!r:.60}, expected three weights that sum to 1")
    if abs(sum(weights) - 1) > 0.01:
        raise InputError(f"{where} has barycentric weights that sum to {sum(weights):g}, expected 1")
    return torch.tensor(numbers), torch.tensor(weights) / sum(weights), float(offset or 0.0), offset is None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < float("inf")


def write_map(path: Path, placement: Placement, rig: RigBackend, comments: Mapping[str, str] | None = None) -> None:
    """Write the places of markers as YAML, some with a comment."""
    lines = ["# Markers on the rig's surface, for riginv.invert markers=FILE; a marker without offset_mm is calibrated."]
    lines += [yaml.safe_dump({"rig": rig.name}).strip(), "markers:"]
    for row, name in enumerate(placement.names):
        place: dict[str, Any] = {"triangle": placement.corners[row].tolist()}
        place["barycentric"] = [round(weight, 4) for weight in placement.barycentric[row].tolist()]
        if not bool(placement.calibrated[row]):
            place["offset_mm"] = round(float(placement.offset_mm[row]), 2)
        key = yaml.safe_dump(name, default_style=None, width=10_000).strip().removesuffix("...").strip()
        value = yaml.safe_dump(place, default_flow_style=True, sort_keys=False, width=10_000).strip()
        comment = (comments or {}).get(name, "")
        lines.append(f"  {key}: {value}{f'  # {comment}' if comment else ''}")
    write_text(path, "\n".join(lines) + "\n")


def matched(
    clip: MarkerClip, placement: Placement, path: str, reading: ReadingOptions, fewest: int = FEWEST
) -> tuple[MarkerClip, Placement, list[str]]:
    """The markers that both a clip and a map have, in the map's order, and notes.

    Prefixes such as `actor:` are ignored if the map has none, and nothing is named alike without them.

    Args:
        path: of the map, for messages.
        reading: `unknown`, the policy for names that only one of them has.
        fewest: markers that are needed.

    Raises:
        InputError: names do not match and the policy does not ignore that, or too few do.
    """
    names, notes = list(clip.names), []
    if not set(names) & set(placement.names):
        names = _without_prefixes(names, placement.names)
    rows = [row for row, name in enumerate(placement.names) if name in names]
    if len(rows) < fewest:  # no policy helps
        raise InputError(
            f"{clip.path}: {len(rows)} of its markers are in the map {path}, expected {fewest} at least: the clip has "
            f"{listed(map(repr, names))}, the map {listed(map(repr, placement.names))}; name the map's markers as the clip "
            f"does, or make a map for this clip with riginv.markers"
        )
    new = [name for name in names if name not in placement.names]
    missing = [name for name in placement.names if name not in names]
    if new and not reading.accepts_new:
        raise InputError(
            f"{clip.path}: {listed(map(repr, new))} are not in the map {path}, which has {listed(map(repr, placement.names))}: "
            f"add them, or leave them out with reading.unknown=ignore_new"
        )
    if missing and not reading.accepts_missing:
        raise InputError(
            f"{clip.path}: {listed(map(repr, missing))} of the map {path} are not in the clip, which has "
            f"{listed(map(repr, names))}: mend the map, or do without them with reading.unknown=ignore_missing"
        )
    if new:
        notes.append(f"markers that the map lacks were left out: {listed(map(repr, new))}")
    if missing:
        notes.append(f"markers of the map that the clip lacks: {listed(map(repr, missing))}")
    shared = placement.subset(rows)
    columns = [names.index(name) for name in shared.names]
    return clip.select(shared.names, clip.points[:, columns], clip.frame_numbers), shared, notes


def _without_prefixes(names: list[str], known: Sequence[str]) -> list[str]:
    """Names without their prefixes; of clips with several prefixes only those that are known, once, without it."""
    bare = [name.rpartition(":")[2] for name in names]
    if len({name.rpartition(":")[0] for name in names}) == 1:
        return bare
    return [short if short in known and bare.count(short) == 1 else name for name, short in zip(names, bare)]
