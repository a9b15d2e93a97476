"""How far sampling is."""

from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn

from riginv.cli.bar import Bar


class SamplingProgress(Bar):
    """A bar for one thing after another; only where there is a terminal."""

    def __init__(self) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(24),
            TaskProgressColumn(show_speed=True),
            TextColumn("{task.completed:,.0f} of {task.total:,.0f} poses"),
            TimeRemainingColumn(),
        )
        self.task = None

    def begin(self, what: str, poses: int) -> None:
        """Something else is counted from now on."""
        if self.task is not None:
            self.bar.remove_task(self.task)
        self.task = self.bar.add_task(what, total=poses)

    def advance(self, poses: int) -> None:
        self.bar.advance(self.task, poses)
