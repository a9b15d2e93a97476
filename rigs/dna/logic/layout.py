"""The base class of evaluated modules, and the layout of controls with checks of indices and numbers of a file."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from riginv.errors import InputError
from rigs.dna.format import DnaFile
from rigs.dna.format.later_layers import MachineLearning, RadialBasis, RadialBasisOutputs
from rigs.dna.format.layers import Behavior, Definition, Descriptor, Lods

MOST_NUMBERS = 50_000_000  # of a padded table: production heads need a hundredth of it


class Stage(nn.Module):
    """A module with non-persistent buffers and no parameters."""

    def keep(self, **values: Tensor | np.ndarray) -> None:
        """Register buffers; indices become int64."""
        for name, value in values.items():
            tensor = torch.as_tensor(np.array(value)) if isinstance(value, np.ndarray) else value
            self.register_buffer(name, tensor if tensor.is_floating_point() else tensor.long(), persistent=False)


def put(controls: Tensor, indices: Tensor, values: Tensor) -> Tensor:
    """Copy of controls `(batch, control)` with values `(batch, index)` at `indices`."""
    return controls.index_copy(1, indices, values)


@dataclass(frozen=True)
class Layout:
    """The controls of a file as one list: raw, PSD, ML, RBF; all of its indices refer to it.

    Attributes:
        where: the file, for messages.
        gui, raw, psd, ml, rbf: number of controls of each kind.
        lod_count: number of levels of detail.
    """

    where: str
    gui: int
    raw: int
    psd: int
    ml: int
    rbf: int
    lod_count: int

    @classmethod
    def of(cls, file: DnaFile) -> "Layout":
        """The layout of a file.

        Raises:
            InputError: it lacks layers.
        """
        definition, behavior = file.need(Definition), file.need(Behavior)
        learned, radial, outputs = file.find(MachineLearning), file.find(RadialBasis), file.find(RadialBasisOutputs)
        rbf = len(outputs.controls) if outputs is not None else len(radial.poses) if radial is not None else 0
        return cls(
            where=file.path,
            gui=len(definition.gui_controls),
            raw=len(definition.raw_controls),
            psd=behavior.controls.psd_count,
            ml=len(learned.controls) if learned else 0,
            rbf=rbf,
            lod_count=file.need(Descriptor).lod_count,
        )

    @property
    def total(self) -> int:
        return self.raw + self.psd + self.ml + self.rbf

    @property
    def psds(self) -> slice:
        return slice(self.raw, self.raw + self.psd)

    @property
    def mls(self) -> slice:
        return slice(self.psds.stop, self.psds.stop + self.ml)

    @property
    def rbfs(self) -> slice:
        return slice(self.mls.stop, self.total)

    def check_controls(self, what: str, indices: np.ndarray) -> None:
        """Raises InputError where an index is that of no control."""
        self.check(what, indices, self.total, "controls")

    def check(self, what: str, indices: np.ndarray, count: int, things: str) -> None:
        """Raises InputError where an index is not below a count of things."""
        if len(indices) and int(np.max(indices)) >= count:
            there = f"0 to {count - 1}" if count else "none"
            raise self.wrong(f"{what} uses number {int(np.max(indices))} of its {things}, it has {there}")

    def check_finite(self, what: str, values: np.ndarray) -> None:
        """Raises InputError where a number is NaN or infinite."""
        if not np.isfinite(values).all():
            raise self.wrong(f"{what} holds {int((~np.isfinite(values)).sum())} numbers that are NaN or infinite")

    def check_lengths(self, what: str, **lengths: int) -> None:
        """Raises InputError where lists that belong together have different lengths."""
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{count} {name}" for name, count in lengths.items())
            raise self.wrong(f"{what} has lists of different lengths: {counts}")

    def check_room(self, what: str, *sizes: int) -> None:
        """Raises InputError where a table of such sizes would be far larger than could be meant."""
        if math.prod(sizes) > MOST_NUMBERS:
            shape = " x ".join(f"{size:,}" for size in sizes)
            raise self.wrong(f"{what} needs a table of {shape} numbers, more than could be meant")

    def wrong(self, found: str) -> InputError:
        """The error for invalid content."""
        return InputError(f"{self.where}: {found}: the file is damaged, or was written wrongly; export it again")

    def of_lod(self, what: str, counts: np.ndarray, lod: int, most: int) -> int:
        """Number of rows, of `most`, that a level of detail uses; all where the file does not limit them.

        Raises:
            InputError: more than there are.
        """
        if not len(counts):
            return most
        count = int(counts[min(lod, len(counts) - 1)])
        if count > most:
            raise self.wrong(f"{what} uses {count} rows at level of detail {lod}, there are {most}")
        return count

    def rows_of_lod(self, what: str, lods: Lods, lod: int, count: int, things: str) -> np.ndarray:
        """The indices that a level of detail has in a table of such.

        Raises:
            InputError: the table is damaged.
        """
        if not len(lods.row_of_lod):
            return np.zeros(0, np.int64)
        row = int(lods.row_of_lod[min(lod, len(lods.row_of_lod) - 1)])
        if row >= len(lods.rows):
            raise self.wrong(f"{what}: level of detail {lod} uses row {row} of {len(lods.rows)}")
        self.check(f"{what}, level of detail {lod}", lods.rows[row], count, things)
        return lods.rows[row].astype(np.int64)


def quaternion_groups(groups: Sequence[np.ndarray]) -> np.ndarray:
    """Controls that hold quaternions, `(group, 4)` as x y z w, each group once."""
    unique = dict.fromkeys(tuple(int(index) for index in group) for group in groups)
    return np.array(list(unique), dtype=np.int64).reshape(-1, 4)
