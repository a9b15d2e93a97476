"""Selection, renaming and limits of the controls of a .blend, by globs."""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import zip_longest

from riginv.errors import InputError
from riginv.rig.interface import Control


@dataclass(frozen=True)
class Selection:
    """Selection of controls; globs of `include`, `exclude` and `rename` match names in the .blend.

    Attributes:
        include: controls to keep; empty: all.
        exclude: controls to leave out.
        rename: glob -> new name; each `*` of the new name is replaced by what the same `*` of the glob matched.
        bounds: glob for new names -> (lower, upper).
    """

    include: Sequence[str] = ()
    exclude: Sequence[str] = ()
    rename: Mapping[str, str] | None = None
    bounds: Mapping[str, Sequence[float]] | None = None


def select(found: Sequence[Control], selection: Selection, source: str) -> tuple[list[str], list[Control]]:
    """Names in the .blend, and the controls of the rig.

    Args:
        source: of the controls, for messages.

    Raises:
        InputError: a glob matches nothing, a bound is not a pair of ascending numbers, or no control remains.
    """
    names = [control.name for control in found]
    for key in ("include", "exclude"):
        if isinstance(getattr(selection, key), str):
            raise InputError(
                f"rig.{key} is '{getattr(selection, key)}', expected a list: rig.{key}=[{getattr(selection, key)}]"
            )
    for key in ("include", "exclude", "rename"):
        for pattern in getattr(selection, key) or ():
            _must_fit(pattern, names, f"rig.{key}", source)
    chosen = [control for control in found if _fits(control.name, selection.include or ["*"])]
    chosen = [control for control in chosen if not _fits(control.name, selection.exclude)]
    if not chosen:
        raise InputError(f"{source}: rig.include and rig.exclude leave none of its {len(found)} controls")
    renamed = [_renamed(control.name, selection.rename or {}) for control in chosen]
    for pattern in selection.bounds or ():
        _must_fit(pattern, renamed, "rig.bounds", source)
    return [control.name for control in chosen], [_bounded(*pair, selection) for pair in zip(chosen, renamed)]


def _fits(name: str, patterns: Sequence[str] | Mapping) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def _must_fit(pattern: str, names: list[str], key: str, source: str) -> None:
    if not any(fnmatchcase(name, pattern) for name in names):
        near = difflib.get_close_matches(pattern, names, n=3, cutoff=0.5) or names[:3]
        raise InputError(f"{key}: '{pattern}' fits none of the {len(names)} controls of {source}, such as {', '.join(near)}")


def _renamed(name: str, rename: Mapping[str, str]) -> str:
    for pattern, new in rename.items():
        match = re.fullmatch("".join(_as_regex(part) for part in re.split(r"([*?])", pattern)), name)
        if match:
            first, *parts = re.split(r"[*?]", new)
            return first + "".join(a + b for a, b in zip_longest(match.groups()[: len(parts)], parts, fillvalue=""))
    return name


def _as_regex(part: str) -> str:
    return {"*": "(.*)", "?": "(.)"}.get(part, re.escape(part))


def _bounded(control: Control, name: str, selection: Selection) -> Control:
    lower, upper = control.lower, control.upper
    for pattern, bounds in (selection.bounds or {}).items():
        if not fnmatchcase(name, pattern):
            continue
        if not (isinstance(bounds, Sequence) and len(bounds) == 2 and all(isinstance(value, int | float) for value in bounds)):
            raise InputError(f"rig.bounds: '{pattern}' is {bounds!r}, expected [lower, upper]")
        lower, upper = map(float, bounds)
    return Control(name, lower, upper, control.neutral, control.unit)
