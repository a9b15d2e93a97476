"""Is a store whole? Every chunk is read, and compared with its row of the ledger."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from riginv.store.layout import BASIS, NEUTRAL
from riginv.store.store import DamagedError, PoseStore


@dataclass
class Condition:
    """What a store is found to be.

    Attributes:
        absent: chunks that have not been written, or whose writing was stopped.
        damaged: chunks that are not what was written, and what is wrong with each.
    """

    absent: list[int] = field(default_factory=list)
    damaged: dict[int, str] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        return not self.absent and not self.damaged

    @property
    def holes(self) -> list[int]:
        """The chunks to make."""
        return sorted([*self.absent, *self.damaged])


def examine(
    store: PoseStore, chunks: Iterable[int] | None = None, thorough: bool = True, advance: Callable[[int], None] | None = None
) -> Condition:
    """Look at chunks of a store.

    Args:
        chunks: which; None: all.
        thorough: read them; else the ledger is believed.
        advance: told the poses of each chunk that was looked at.

    Raises:
        DamagedError: what belongs to no chunk is damaged, which cannot be mended.
    """
    for name in (NEUTRAL, BASIS):
        if name in store.arrays:
            store.constant(name)
    ledger, damaged = store.ledger()
    found = Condition(damaged={chunk: f"chunk {chunk} of 'ledger' is damaged" for chunk in damaged})
    for chunk in range(store.layout.chunks) if chunks is None else chunks:
        if chunk in found.damaged:
            pass
        elif not ledger[chunk, 0]:
            found.absent.append(chunk)
        elif thorough:
            fault = _fault(store, chunk, ledger[chunk])
            if fault:
                found.damaged[chunk] = fault
        if advance:
            advance(store.layout.count(chunk))
    return found


def _fault(store: PoseStore, chunk: int, row: np.ndarray) -> str | None:
    for name in store.layout.checked:
        try:
            store.read_checked(name, chunk, row)
        except DamagedError as error:
            return str(error).removeprefix(f"{store}: ").partition(": give")[0]
    return None
