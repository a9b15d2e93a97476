"""How far sampling is."""

from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn


class SamplingProgress:
    """A bar for one thing after another; only where there is a terminal."""

    def __init__(self) -> None:
        console = Console(stderr=True)
        columns = (
            TextColumn("{task.description}"),
            BarColumn(24),
            TaskProgressColumn(show_speed=True),
            TextColumn("{task.completed:,.0f} of {task.total:,.0f} poses"),
            TimeRemainingColumn(),
        )
        self.bar = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self.task = None

    def __enter__(self) -> "SamplingProgress":
        self.bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.bar.stop()

    def begin(self, what: str, poses: int) -> None:
        """Something else is counted from now on."""
        if self.task is not None:
            self.bar.remove_task(self.task)
        self.task = self.bar.add_task(what, total=poses)

    def advance(self, poses: int) -> None:
        self.bar.advance(self.task, poses)
