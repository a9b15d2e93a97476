"""A bar that says how far long work is."""

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import Progress, ProgressColumn


class Bar:
    """To be entered while the work goes on; where there is no terminal nothing is drawn.

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
