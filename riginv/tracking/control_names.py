"""Controls named by globs, pairs or a mask file, and the policy for unknown names."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import yaml

from riginv.errors import InputError
from riginv.rig.interface import RigBackend

SIDES = (
    ("Left", "Right"),
    ("left", "right"),
    ("_L", "_R"),
    (".L", ".R"),
    ("_l", "_r"),
    (".l", ".r"),
    ("L_", "R_"),
    ("l_", "r_"),
)
MAX_MASK_BYTES = 1 << 24


class ControlNames:
    """The names of a rig's controls, and a policy for names that do not match.

    Args:
        policy: `error`; `ignore_new`: unknown names are ignored; `ignore_missing`: controls that a mask does not name are
            free; `ignore_both`.
    """

    def __init__(self, rig: RigBackend, policy: str) -> None:
        self.rig, self.names = rig.name, rig.control_names
        self.number = {name: number for number, name in enumerate(self.names)}
        self.accept_new = policy in ("ignore_new", "ignore_both")
        self.accept_missing = policy in ("ignore_missing", "ignore_both")

    def matching(self, globs: Sequence[str], key: str) -> list[int]:
        """The sorted indices of the controls that any of the globs matches.

        Raises:
            InputError: a glob matches none, and the policy does not ignore that.
        """
        found: set[int] = set()
        for glob in globs:
            matching = {number for number, name in enumerate(self.names) if fnmatchcase(name, glob)}
            if not matching and not self.accept_new:
                raise self._unknown(key, glob)
            found |= matching
        return sorted(found)

    def pairs(self, given: str | Sequence[tuple[str, str]], key: str) -> list[tuple[int, int]]:
        """Indices of pairs of controls; `auto`: all that differ only in their side, such as `browDownLeft`, `browDownRight`.

        Raises:
            InputError: a name is not known, and the policy does not ignore that.
        """
        if isinstance(given, str):
            return [(number, other) for name, number in self.number.items() if (other := self._other_side(name)) is not None]
        found = []
        for pair in given:
            unknown = [name for name in pair if name not in self.number]
            if unknown and not self.accept_new:
                raise self._unknown(key, unknown[0])
            if not unknown and pair[0] != pair[1]:
                found.append((self.number[pair[0]], self.number[pair[1]]))
        return found

    def _other_side(self, name: str) -> int | None:
        for left, right in SIDES:
            if left in name and (other := self.number.get(name.replace(left, right))) is not None:
                return other
        return None

    def mask(self, path: Path) -> dict[int, float]:
        """The weight of each control that a mask names, by index: 0 fixes it, 1 leaves it free.

        Raises:
            InputError: the file is no mask; it names unknown controls, or does not name all controls.
        """
        found: dict[int, float] = {}
        for name, value in read_mask(path).items():
            if name in self.number:
                found[self.number[name]] = value
            elif not self.accept_new:
                raise self._unknown(str(path), name)
        left_out = [name for name in self.names if self.number[name] not in found]
        if left_out and not self.accept_missing:
            raise InputError(
                f"{path}: does not name {len(left_out)} of the {len(self.names)} controls of rig '{self.rig}', the first: "
                f"{', '.join(left_out[:4])}; add them, or leave them free with controls.unknown=ignore_missing"
            )
        return found

    def _unknown(self, where: str, name: str) -> InputError:
        near = [known for known in self.names if name.strip("*").lower() in known.lower()][:3] or self.names[:4]
        return InputError(
            f"{where} names {name!r}, and rig '{self.rig}' has no such control; it has {', '.join(near)} and others; mend the "
            f"name, or ignore it with controls.unknown=ignore_new"
        )


def read_mask(path: Path) -> dict[str, float]:
    """Control names to weights of at least 0, from .json, .yaml, or .csv with a name and a weight in each row.

    Raises:
        InputError: the file is missing or no mask.
    """
    try:
        if path.stat().st_size > MAX_MASK_BYTES:
            raise InputError(f"{path}: {path.stat().st_size} bytes are no mask: expected a weight for each control's name")
        text = path.read_text(encoding="utf-8-sig")
        if path.suffix == ".csv":
            rows = [row for row in csv.reader(io.StringIO(text)) if row]
            content = {row[0].strip(): float(row[1]) for row in rows}
        else:
            content = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file, named by controls.mask") from None
    except (OSError, ValueError, IndexError, RecursionError, csv.Error, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: no mask of names and weights that can be read: {reason}") from None
    if not isinstance(content, Mapping):
        raise InputError(f"{path}: holds {type(content).__name__}, expected names of controls, each with a weight: jawOpen: 1")
    for name, value in content.items():
        if not isinstance(name, str) or not isinstance(value, int | float) or not 0 <= value < float("inf"):
            raise InputError(f"{path}: {name!r} has {value!r}, expected a weight of at least 0 (0 fixes a control, 1 frees it)")
    return {name: float(value) for name, value in content.items()}
