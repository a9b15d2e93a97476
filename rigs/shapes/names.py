"""The naming convention of in-betweens and combinations.

`a50` is the in-between of `a` at half its weight. `a_b`, `a_b_c` ... are combinations: `a` and `b` (and `c`) at weight 1.
The parts of a combination may be in-betweens (`a50_b`), and a combination may have in-betweens of its own
(`a_b50`, where there is no shape `b50`: both at half). Every other name is a primary shape, underscores included (`brow_up_L`).
"""

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from riginv.errors import InputError

MOST_NOTES = 5
INBETWEEN = re.compile(r"(.*\D)(\d\d)")  # two digits: percent


@dataclass(frozen=True)
class Convention:
    """Shapes by kind.

    Attributes:
        primaries: shapes with their own controls.
        inbetweens: name -> primary shape, and its weight at the in-between.
        combinations: name -> primary shapes and in-betweens that it combines.
        combination_inbetweens: name -> combination, and the weight of its shapes at the in-between.
    """

    primaries: list[str] = field(default_factory=list)
    inbetweens: dict[str, tuple[str, float]] = field(default_factory=dict)
    combinations: dict[str, tuple[str, ...]] = field(default_factory=dict)
    combination_inbetweens: dict[str, tuple[str, float]] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """All shapes, those that correct others last."""
        return [*self.primaries, *self.inbetweens, *self.combinations, *self.combination_inbetweens]

    def counts(self) -> str:
        """Number of shapes of each kind, in words."""
        kinds = {
            "primary shape{}": self.primaries,
            "in-between{}": self.inbetweens,
            "combination{}": self.combinations,
            "in-between{} of combinations": self.combination_inbetweens,
        }
        return ", ".join(
            f"{len(shapes)} {kind.format('s' if len(shapes) > 1 else '')}" for kind, shapes in kinds.items() if shapes
        )

    def pose(self, name: str) -> Mapping[str, float]:
        """The weights of the primary shapes at which a shape was sculpted; the others are 0."""
        if name in self.inbetweens:
            return dict([self.inbetweens[name]])
        if name in self.combinations:
            return {shape: weight for member in self.combinations[name] for shape, weight in self.pose(member).items()}
        if name in self.combination_inbetweens:
            combination, position = self.combination_inbetweens[name]
            return dict.fromkeys(self.pose(combination), position)
        return {name: 1.0}


def read_names(names: Iterable[str]) -> Convention:
    """Classify shapes by the convention: shorter names first, so that the parts of a name are known before it.

    Raises:
        InputError: two shapes are combinations of the same shapes.
    """
    shapes = Convention()
    combined: dict[frozenset[str], str] = {}
    for name in sorted(names, key=lambda name: (name.count("_"), len(name), name)):
        members = _members(name, shapes)
        digits = INBETWEEN.fullmatch(name)
        owner, position = (digits[1], int(digits[2]) / 100) if digits and digits[2] != "00" else ("", 0.0)
        if members:
            twin = combined.setdefault(frozenset(members), name)
            if twin != name:
                raise InputError(
                    f"shapes '{twin}' and '{name}' both combine {' and '.join(members)}: keep one of them, or leave one out "
                    "with rig.exclude"
                )
            shapes.combinations[name] = members
        elif owner in shapes.primaries:
            shapes.inbetweens[name] = (owner, position)
        elif owner in shapes.combinations and all(member in shapes.primaries for member in shapes.combinations[owner]):
            shapes.combination_inbetweens[name] = (owner, position)
        else:
            shapes.primaries.append(name)
    shapes.primaries.sort()
    return shapes


def misspelt_notes(found: Convention) -> list[str]:
    """Notes on primary shapes that look like combinations with a misspelt part, limited in number."""
    notes = [
        f"{name} is a shape of its own, for there is no '{part}'; if '{near}' is meant, rename the file"
        for name, (part, near) in misspelt_parts(found).items()
    ]
    more = len(notes) - MOST_NOTES
    return [*notes[:MOST_NOTES], *([f"{more} more shapes look like combinations with a misspelt part"] if more > 0 else [])]


def misspelt_parts(found: Convention) -> dict[str, tuple[str, str]]:
    """Primary shapes that look like combinations with a misspelt part: name -> that part, and the probable spelling."""
    result = {}
    known = [*found.primaries, *found.inbetweens]
    for name in found.primaries:
        parts = name.split("_")
        for cut in range(1, len(parts)):
            halves = "_".join(parts[:cut]), "_".join(parts[cut:])
            for one, other in (halves, halves[::-1]):
                if one in known and (near := difflib.get_close_matches(other, known, n=1, cutoff=0.8)):
                    result[name] = (other, near[0])
    return result


def _members(name: str, found: Convention) -> tuple[str, ...]:
    """Shapes that a name joins by underscores; empty for none.

    Ambiguous names are split greedily: the longest first part, then the longest second part, and so on.
    """
    parts = name.split("_")
    split: dict[int, list[str]] = {len(parts): []}  # start of the remaining name -> shapes that it joins
    for start in reversed(range(len(parts))):
        for end in range(len(parts), start, -1):
            first = "_".join(parts[start:end])
            if end in split and (first in found.primaries or first in found.inbetweens):
                split[start] = [first, *split[end]]
                break
    members = split.get(0, [])
    owners = {found.inbetweens.get(member, (member,))[0] for member in members}
    return tuple(members) if len(members) > 1 and len(owners) == len(members) else ()
