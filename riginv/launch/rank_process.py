"""A rank process started by `riginv.launch.device_launcher`: reports its exception to a file, and exits with its launcher.

The launcher prints one of the reports, as all ranks fail together.
"""

import json
import os
import traceback
from dataclasses import asdict, dataclass
from pathlib import Path

from riginv.launch.job_process import exit_with_process

LAUNCHER_PID, REPORT = "RIGINV_LAUNCHER_PID", "RIGINV_REPORT"


@dataclass(frozen=True)
class Report:
    """The exception that ended a rank process.

    Attributes:
        text: a sentence for the user, or a traceback.
        explained: whether it is that sentence.
    """

    text: str
    explained: bool


def is_rank_process() -> bool:
    """Whether a launcher has started this process as one of several ranks."""
    return LAUNCHER_PID in os.environ


def report(error: BaseException, message: str | None) -> None:
    """Write the error to the launcher's report file: the message for the user, or the traceback."""
    text = Report(message or "".join(traceback.format_exception(error)), explained=message is not None)
    Path(os.environ[REPORT]).write_text(json.dumps(asdict(text)), encoding="utf-8")


def read_report(path: Path) -> Report | None:
    """The report of a process, or None."""
    return Report(**json.loads(path.read_text(encoding="utf-8"))) if path.is_file() and path.stat().st_size else None


def exit_with_launcher() -> None:
    """Exit as soon as the launcher has ended."""
    exit_with_process(int(os.environ[LAUNCHER_PID]))
