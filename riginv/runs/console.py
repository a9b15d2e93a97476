"""Terminal output beside tables: lines, notes and warnings, and progress bars."""

from collections.abc import Sequence
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import Progress, ProgressColumn
from rich.text import Text


class Bar:
    """A progress bar as a context manager; without a terminal nothing is drawn.

    Args:
        columns: of Rich's.

    Attributes:
        console: to print beside the bar.
        bar: Rich's own.
    """

    def __init__(self, *columns: ProgressColumn) -> None:
        self.console = Console(stderr=True)
        self.bar = Progress(*columns, console=self.console, transient=True, disable=not self.console.is_terminal)

    def __enter__(self) -> Self:
        self.bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.bar.stop()


def show_lines(
    lines: Sequence[str], notes: Sequence[str] = (), warnings: Sequence[str] = (), console: Console | None = None
) -> None:
    """Print lines, notes and warnings, each in a line of its own; to standard error, where no console is named."""
    console = console or Console(stderr=True)
    for start, texts, style in (("", lines, ""), ("note: ", notes, ""), ("warning: ", warnings, "yellow")):
        for text in texts:
            console.print(Text.assemble((start, style), text), highlight=False, soft_wrap=True)


def show_result(text: str) -> None:
    """Print what a command has made, as one line of standard output."""
    show_lines([text], console=Console())


def duration(seconds: float) -> str:
    """Seconds in words: `48 s`, `12 min`, `31 h`, `12 days`."""
    for limit, unit, one in ((90, "s", 1), (5400, "min", 60), (48 * 3600, "h", 3600)):
        if seconds < limit:
            return f"{seconds / one:.0f} {unit}"
    return f"{seconds / 86400:.0f} days"
