"""Values of frames, kept in memory as far as a limit allows, so that scans are read and matched once."""

from collections.abc import Callable
from typing import Generic, TypeVar

Value = TypeVar("Value")
MAX_POINTS = 500_000  # of the kept scans together: some 200 MB with their search trees


class LimitedCache(Generic[Value]):
    """A function of a row whose values are kept while their sizes fit in a limit; others are computed again.

    Args:
        compute: the value of a row.
        size: of a value.
        limit: of the sum of the sizes.
    """

    def __init__(self, compute: Callable[[int], Value], size: Callable[[Value], int], limit: int = MAX_POINTS) -> None:
        self.compute, self.size, self.room = compute, size, limit
        self.values: dict[int, Value] = {}

    def __call__(self, row: int) -> Value:
        if row in self.values:
            return self.values[row]
        value = self.compute(row)
        if self.size(value) <= self.room:
            self.values[row] = value
            self.room -= self.size(value)
        return value

    def drop_before(self, first: int) -> None:
        """Make room: drop the values of rows before `first`."""
        for row in [row for row in self.values if row < first]:
            self.room += self.size(self.values.pop(row))
