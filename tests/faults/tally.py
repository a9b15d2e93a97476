"""How many faults were injected, and how many survived: printed as a table when the tests end."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

ROWS: dict[str, "Row"] = {}


@dataclass
class Row:
    """One kind of fault.

    Attributes:
        injected: how often.
        survived: how often all was there again in the end, and the same as without the fault; the rest was lost.
        how: in a few words.
    """

    injected: int = 0
    survived: int = 0
    how: str = ""


@contextmanager
def fault(kind: str, how: str, count: int = 1) -> Iterator[None]:
    """Count faults as injected, and as survived where the block comes to its end."""
    row = ROWS.setdefault(kind, Row(how=how))
    row.injected += count
    yield
    row.survived += count


def table() -> list[str]:
    """The rows as Markdown, and their sums."""
    total = Row(sum(row.injected for row in ROWS.values()), sum(row.survived for row in ROWS.values()))
    lines = ["| fault | injected | survived | lost | how it survives |", "|---|---:|---:|---:|---|"]
    for kind, row in [*ROWS.items(), ("**all**", total)]:
        lines.append(f"| {kind} | {row.injected} | {row.survived} | {row.injected - row.survived} | {row.how} |")
    return lines
