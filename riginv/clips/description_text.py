"""The description of a clip in words: a line for the terminal, table rows for the page."""

from collections.abc import Sequence

from riginv.clips.clip import Clip
from riginv.clips.description import ClipDescription, FrameSpan, describe
from riginv.clips.options import UNITS
from riginv.clips.units import AS_THE_FILE_SAYS
from riginv.errors import counted, listed, printable
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
        text = f"mesh {_short(facts.meshes[0])}" if meshes == 1 and detail < NO_NAMES else counted(meshes, "mesh", "meshes")
        parts.append(text + (f" ({others:,} left out)" if others else ""))
    if facts.animation:
        passed = len(facts.other_animations)
        parts.append(f"animation {_short(facts.animation)}" + (f" ({passed:,} ignored)" if passed else ""))
    return parts


def frames_text(span: FrameSpan) -> str:
    """A range of frames in words."""
    return f"1 frame, {span.first}" if span.count == 1 else f"{span.count:,} frames {span.first} to {span.last}"


def unit_text(mm: float | None, source: str) -> str:
    """A unit in words, None: not known, and where it comes from."""
    if not mm:
        return "not known"
    name = next((name for name, known in UNITS.items() if abs(known - mm) < 1e-6 * known), f"{mm:g} mm")
    return f"{name} ({source})" if source else name


def _frames(clip: ClipDescription, detail: int = FULL) -> str:
    text, count = frames_text(clip.frames), clip.frames.count
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
    return f"unit {unit_text(clip.unit_mm, clip.unit_source if _says(clip.unit_source, detail) else '')}"


def _up(clip: ClipDescription, detail: int) -> str:
    return f"{clip.up} up{_source(clip.up_source, detail)}"


def _rate(clip: ClipDescription, detail: int) -> str:
    return f"{clip.fps:g} fps" + (f" ({_short(clip.rate_source)})" if detail < NO_SOURCES else "")


def _source(source: str, detail: int) -> str:
    """The source of an axis, in parentheses; omitted at low `detail`."""
    return f" ({source})" if _says(source, detail) else ""


def _says(source: str, detail: int) -> bool:
    """Whether a line says the source of a unit or an axis."""
    return detail == FULL or (detail < NO_SOURCES and source != AS_THE_FILE_SAYS)


def _motion(clip: ClipDescription) -> str:
    motion = clip.motion
    if clip.frames.count == 1:
        return "none: it has one frame"
    text = f"up to {motion.farthest_mm:.3g} {'mm' if clip.unit_mm else 'units'} from the first frame"
    text += f", at up to {motion.fastest_m_s:.3g} m/s" if clip.unit_mm else ""
    return text + (f" ({motion.frames:,} frames looked at)" if motion.frames < motion.all_frames else "")


def _short(text: str) -> str:
    """A text cut to the length of a name."""
    text = printable(text)
    return text if len(text) <= LONGEST_NAME else f"{text[: LONGEST_NAME - 15]}...{text[-12:]}"
