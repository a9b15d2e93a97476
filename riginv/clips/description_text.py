"""The description of a clip in words: a line for the terminal, table rows for the page."""

from collections.abc import Sequence

from riginv.clips.clip import Clip
from riginv.clips.description import ClipDescription, describe
from riginv.clips.options import UNITS
from riginv.clips.units import AS_THE_FILE_SAYS
from riginv.errors import listed, printable
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.size import extent
from riginv.runs.console import show_lines

LONGEST_LINE = 200  # characters
LONGEST_NAME = 40
NAMES = 12  # meshes or animations listed in a table row
FULL, NO_FILE, NO_NAMES, NO_SOURCES = range(4)  # levels of detail of a line: each omits more


def line(clip: ClipDescription) -> str:
    """The description in one line of at most `LONGEST_LINE` characters, which starts with the file's name."""
    start = f"clip {_short(clip.file)}: "
    return start + in_short(clip, LONGEST_LINE - len(start))


def in_short(clip: ClipDescription, most: int = LONGEST_LINE) -> str:
    """The description in at most `most` characters, with as much detail as fits."""
    for detail in (FULL, NO_FILE, NO_NAMES, NO_SOURCES):
        parts = [clip.facts.format, *_contents(clip, detail), _frames(clip, detail), _rate(clip, detail)]
        parts += [_length(clip), _size(clip), _unit(clip, detail), _up(clip, detail)]
        text = printable(", ".join(filter(None, parts)))
        if len(text) <= most:
            return text
    return text[: most - 3] + "..."


def show_clip(meshes: MeshSet | None) -> ClipDescription | None:
    """Print and return the description of a clip, or of the clip a set was made from (`meshes.clip`); None for other sets.

    The notes of the set are printed in any case.
    """
    clip = meshes if isinstance(meshes, Clip) else getattr(meshes, "clip", None)
    found = describe(clip) if clip is not None else None
    show_lines([line(found)] if found else [], meshes.notes if meshes else (), found.warnings if found else ())
    return found


def rows(clip: ClipDescription, names: int | None = NAMES) -> list[tuple[str, str]]:
    """The description as table rows (label, value).

    Args:
        names: meshes or animations listed in a row, at most; None: all.
    """
    facts = clip.facts
    found = [
        ("format", facts.format),
        ("meshes", cell_of(facts.meshes, names)),
        ("meshes left out", cell_of(facts.other_meshes, names)),
        ("animation", facts.animation),
        ("animations ignored", cell_of(facts.other_animations, names)),
        ("vertices", f"{clip.vertices:,}" + (f", {clip.faces:,} faces" if clip.faces else "")),
        ("frames", _frames(clip)),
        ("rate", f"{clip.fps:g} frames a second ({clip.rate_source})"),
        ("length", _length(clip)),
        ("size", _size(clip)),
        ("unit", _unit(clip).removeprefix("unit ")),
        ("up", f"{clip.up} ({clip.up_source})"),
        ("motion", _motion(clip)),
    ]
    return [(name, printable(text)) for name, text in found if text]


def cell_of(names: Sequence[str], most: int | None = NAMES) -> str:
    """Names in a table cell, as `listed`, with a hint where some are left out; empty without names."""
    hint = " (verbose=true names all)" if most is not None and len(names) > most else ""
    return listed(names, most) + hint if names else ""


def _contents(clip: ClipDescription, detail: int) -> list[str]:
    """Meshes and animation."""
    facts, parts = clip.facts, []
    meshes, others = len(facts.meshes), len(facts.other_meshes)
    if meshes or others:
        text = f"mesh {_short(facts.meshes[0])}" if meshes == 1 and detail < NO_NAMES else _count(meshes, "mesh", "meshes")
        parts.append(text + (f" ({others:,} left out)" if others else ""))
    if facts.animation:
        passed = len(facts.other_animations)
        parts.append(f"animation {_short(facts.animation)}" + (f" ({passed:,} ignored)" if passed else ""))
    return parts


def _frames(clip: ClipDescription, detail: int = FULL) -> str:
    first, last, count = clip.frames.first, clip.frames.last, clip.frames.count
    text = f"1 frame, {first}" if count == 1 else f"{count:,} frames {first} to {last}"
    if count < clip.all_frames.count:
        text += f" of {clip.all_frames.first} to {clip.all_frames.last}"
    details = []
    if clip.missing:
        names = ", ".join(map(str, clip.missing_first)) + (", ..." if clip.missing > len(clip.missing_first) else "")
        details.append(f"{clip.missing:,} missing" + (f": {names}" if detail < NO_NAMES else ""))
    if clip.excluded:
        details.append(f"{clip.excluded:,} excluded")
    if unknown := max(0, clip.motion.unknown - clip.excluded):
        details.append(f"{unknown:,} not known")
    return text + (f" ({'; '.join(details)})" if details else "")


def _length(clip: ClipDescription) -> str:
    return f"{clip.seconds:.4g} s"


def _size(clip: ClipDescription) -> str:
    return extent(clip.motion.size_mm, "" if clip.unit_mm else "units")


def _unit(clip: ClipDescription, detail: int = FULL) -> str:
    if not clip.unit_mm:
        return "unit not known"
    name = next((name for name, mm in UNITS.items() if abs(mm - clip.unit_mm) < 1e-6 * mm), f"{clip.unit_mm:g} mm")
    return f"unit {name}{_source(clip.unit_source, detail)}"


def _up(clip: ClipDescription, detail: int) -> str:
    return f"{clip.up} up{_source(clip.up_source, detail)}"


def _rate(clip: ClipDescription, detail: int) -> str:
    return f"{clip.fps:g} fps" + (f" ({_short(clip.rate_source)})" if detail < NO_SOURCES else "")


def _source(source: str, detail: int) -> str:
    """The source of a unit or an axis, in parentheses; omitted at low `detail`."""
    shown = detail == FULL or (detail < NO_SOURCES and source != AS_THE_FILE_SAYS)
    return f" ({source})" if shown else ""


def _motion(clip: ClipDescription) -> str:
    motion = clip.motion
    if clip.frames.count == 1:
        return "none: it has one frame"
    text = f"up to {motion.farthest_mm:.3g} {'mm' if clip.unit_mm else 'units'} from the first frame"
    text += f", at up to {motion.fastest_m_s:.3g} m/s" if clip.unit_mm else ""
    return text + (f" ({motion.frames:,} frames looked at)" if motion.frames < motion.all_frames else "")


def _count(count: int, one: str, many: str) -> str:
    return f"{count:,} {one if count == 1 else many}"


def _short(text: str) -> str:
    """A text cut to the length of a name."""
    text = printable(text)
    return text if len(text) <= LONGEST_NAME else f"{text[: LONGEST_NAME - 15]}...{text[-12:]}"
