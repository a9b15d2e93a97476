"""A rank process started by `riginv.launch.starter`: reports its exception to a file, and exits with its launcher.

The launcher prints one of the reports, as all ranks fail together.
"""

import json
import os
import traceback
from dataclasses import asdict, dataclass
from pathlib import Path

from riginv.launch.apart import end_with

WATCHER, REPORT = "RIGINV_WATCHER", "RIGINV_REPORT"


@dataclass(frozen=True)
class Report:
    """What ended a process.

    Attributes:
        text: a sentence for the user, or a traceback.
        explained: whether it is that sentence.
    """

    text: str
    explained: bool


def is_watched() -> bool:
    """Whether another process has started this one for its run."""
    return WATCHER in os.environ


def report(error: BaseException, message: str | None) -> None:
    """Write the error to the launcher's report file: the message for the user, or the traceback."""
    told = Report(message or "".join(traceback.format_exception(error)), explained=message is not None)
    Path(os.environ[REPORT]).write_text(json.dumps(asdict(told)), encoding="utf-8")


def read_report(path: Path) -> Report | None:
    """The report of a process, or None."""
    return Report(**json.loads(path.read_text(encoding="utf-8"))) if path.is_file() and path.stat().st_size else None


def end_with_watcher() -> None:
    """End this process as soon as the one that watches it is gone."""
    end_with(int(os.environ[WATCHER]))
