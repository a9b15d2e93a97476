"""Cases of damage for a reader, and what came of them."""

import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from riginv.errors import InputError
from tests.fuzz.damage import damaged

LONGEST = 1000  # characters of a sentence


@dataclass(frozen=True)
class Target:
    """Something that is read.

    Attributes:
        victims: the files whose bytes are changed, one at a time.
        read: reads it as a command does.
        mend: called after a change, for what a careful attacker would do, such as writing new checksums.
    """

    victims: list[Path]
    read: Callable[[], Any]
    mend: Callable[[], None] = lambda: None


@dataclass
class Tally:
    """What came of the cases of one reader."""

    name: str
    cases: int = 0
    refused: int = 0
    read: int = 0
    crashes: list[str] = field(default_factory=list)


def survive(name: str, target: Target, cases: int, seed: int) -> Tally:
    """Read a target that was damaged in as many ways as asked; whole files come first, and must be read."""
    tally = Tally(name)
    target.read()
    for case in range(cases):
        random = np.random.default_rng([seed, case])
        victim = target.victims[int(random.integers(len(target.victims)))]
        whole = victim.read_bytes()
        victim.write_bytes(damaged(whole, random))
        tally.cases += 1
        try:
            target.mend()
            target.read()
            tally.read += 1
        except InputError as error:
            tally.refused += 1
            if "\n" in str(error) or len(str(error)) > LONGEST:
                tally.crashes.append(f"case {case}, {victim.name}: no sentence: {error}")
        except Exception:
            tally.crashes.append(f"case {case}, {victim.name}: {traceback.format_exc()}")
        finally:
            victim.write_bytes(whole)
            target.mend()
    return tally
