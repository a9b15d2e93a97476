"""Verification of stores: chunks are read and compared with the checksums of the ledger."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from riginv.sampling.store.layout import BASIS, NEUTRAL
from riginv.sampling.store.store import DamagedError, PoseStore


@dataclass
class StoreCondition:
    """State of the chunks of a store.

    Attributes:
        absent: chunks that were not written, or not completely.
        damaged: fault of each chunk that differs from what was written.
    """

    absent: list[int] = field(default_factory=list)
    damaged: dict[int, str] = field(default_factory=dict)

    @property
    def complete(self) -> bool:
        return not self.absent and not self.damaged

    @property
    def incomplete(self) -> list[int]:
        """Chunks to make."""
        return sorted([*self.absent, *self.damaged])


def examine(
    store: PoseStore, chunks: Iterable[int] | None = None, thorough: bool = True, advance: Callable[[int], None] | None = None
) -> StoreCondition:
    """Verify chunks of a store.

    Args:
        chunks: indices; None: all.
        thorough: read the chunks; else only the ledger.
        advance: called with the number of poses of each verified chunk.

    Raises:
        DamagedError: data of no chunk is damaged, which cannot be repaired.
    """
    for name in (NEUTRAL, BASIS):
        if name in store.arrays:
            store.constant(name)
    ledger, damaged = store.ledger()
    condition = StoreCondition(damaged={chunk: f"chunk {chunk} of 'ledger' is damaged" for chunk in damaged})
    for chunk in range(store.layout.chunks) if chunks is None else chunks:
        if chunk in condition.damaged:
            pass
        elif not ledger[chunk, 0]:
            condition.absent.append(chunk)
        elif thorough:
            fault = _fault(store, chunk, ledger[chunk])
            if fault:
                condition.damaged[chunk] = fault
        if advance:
            advance(store.layout.count(chunk))
    return condition


def _fault(store: PoseStore, chunk: int, row: np.ndarray) -> str | None:
    for name in store.layout.checked:
        try:
            store.read_checked(name, chunk, row)
        except DamagedError as error:
            return str(error).removeprefix(f"{store}: ").partition(": give")[0]
    return None
