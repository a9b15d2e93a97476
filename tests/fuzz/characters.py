"""DNA files for the fuzzer: their bytes, and the numbers within files that are whole."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from rigs.dna import DnaRig
from rigs.dna.format import read_dna, write_dna
from rigs.dna.format.container import dna_bytes
from rigs.dna.inverse import TableInverse
from tests.fuzz.tally import Target
from tests.rigs.dna.files import draft, everything, two_levels
from tests.rigs.dna.mutation import mutated

UNCHANGED = b"no change" * 4


def dna(version: int) -> Callable[[Path], Target]:
    """Every layer, or the sections of version 2.1; read, posed, and written again."""

    def make(folder: Path) -> Target:
        file = everything() if version > 1 else dataclasses.replace(two_levels(draft().file()), version=1)
        path = folder / "a.dna"
        write_dna(path, file)

        return Target([path], lambda: read_character(path))

    return make


def read_character(path: Path) -> None:
    found = read_dna(path)
    assert dna_bytes(found)[:3] == b"DNA"
    for controls in ("raw", None):
        rig = DnaRig(str(path), controls)
        with torch.no_grad():
            assert rig(rig.upper[None]).shape[1:] == rig.rest_vertices.shape
    TableInverse(found)(np.full((1, len(DnaRig(str(path), "raw").controls)), 0.5))


def dna_numbers(folder: Path) -> Target:
    """Files whose bytes are in order and whose numbers are not; the bytes that are damaged choose which."""
    seed, path, whole = folder / "seed", folder / "a.dna", everything(operations=True)
    seed.write_bytes(UNCHANGED)

    def read() -> None:
        given = seed.read_bytes()
        random = np.random.default_rng(list(given))
        write_dna(path, whole if given == UNCHANGED else mutated(whole, random))
        read_character(path)

    return Target([seed], read)
