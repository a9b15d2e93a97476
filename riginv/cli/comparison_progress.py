"""How far a comparison is: a bar with the method at work, and a line with the errors of each that has finished."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

from riginv.cli.bar import Bar


class ComparisonProgress(Bar):
    """To be entered with the number of methods; where there is no terminal only the lines are shown."""

    def __init__(self, methods: int) -> None:
        super().__init__(BarColumn(24), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
        self.task = self.bar.add_task("", total=methods)

    def at(self, method: str, what: str) -> None:
        """A method is at something now: a set's name, or that it is being prepared."""
        self.bar.update(self.task, description=f"{method}: {what}")

    def finished(self, method: str, rows: Sequence[Mapping[str, Any]]) -> None:
        """A method is done on every set."""
        errors = ", ".join(f"{row['set'].replace('_', ' ')} {row['mean_vertex_error_mm']:.3g}" for row in rows)
        self.bar.console.print(f"{method}: {errors} mm", soft_wrap=True, highlight=False)
        self.bar.advance(self.task)
