"""The states of a sweep's jobs: one small file for each job in the sweep's folder, which may be shared by machines.

multirun.yaml         what was typed (Hydra's)
jobs/NAME.json        the state of the job NAME
jobs/NAME.log         what it printed, where it ran in a process of its own
NAME/                 the job's own folder; failure.txt has the reason of a failure
sweep.csv, sweep.md   the table, once all have ended
"""

import json
import platform
from dataclasses import asdict, dataclass
from pathlib import Path

from riginv.runs.files import discard, write_json, write_text
from riginv.runs.run_folder import folder_name

JOBS, FAILURE = "jobs", "failure.txt"
TRACEBACK = "Traceback (most recent call last):"
WAITING, RUNNING, FINISHED, FAILED = "waiting", "running", "finished", "failed"


@dataclass
class JobRecord:
    """The state of a job.

    Attributes:
        number: its index in the sweep, from 0.
        name: of its folder.
        swept: its swept overrides, as KEY=VALUE.
        state: waiting, running, finished or failed; still running, too, where everything was killed at once.
        starts: how often it was started.
        why: it failed, as one line.
        seconds: its last start took.
        host: the machine that it ran on.
    """

    number: int
    name: str
    swept: list[str]
    state: str = WAITING
    starts: int = 0
    why: str = ""
    seconds: float = 0.0
    host: str = ""

    @property
    def label(self) -> str:
        return " ".join(self.swept) or self.name

    @property
    def has_ended(self) -> bool:
        return self.state in (FINISHED, FAILED)

    def waits(self, sweep: Path) -> None:
        """Record that the job waits."""
        self._write(sweep, WAITING)

    def started(self, sweep: Path) -> None:
        """Record that the job runs on this machine, and clear an earlier failure."""
        discard(sweep / self.name / FAILURE)
        self.starts, self.why, self.host = self.starts + 1, "", platform.node()
        self._write(sweep, RUNNING)

    def ended(self, sweep: Path, seconds: float, why: str | None) -> None:
        """Record that the job finished, or the reason why it failed, in full in `failure.txt`."""
        self.seconds = round(seconds, 1)
        if why is not None:
            *before, self.why = why.strip().splitlines()
            self.why = self.why if before[:1] == [TRACEBACK] else " ".join([*before, self.why])
            write_text(sweep / self.name / FAILURE, why.strip() + "\n")
        self._write(sweep, FINISHED if why is None else FAILED)

    def _write(self, sweep: Path, state: str) -> None:
        self.state = state
        write_json(record_file(sweep, self.name), asdict(self))


def record_file(sweep: Path, name: str) -> Path:
    """The path of a job's record; its log is beside it."""
    return sweep / JOBS / f"{folder_name(name)}.json"


def read_record(sweep: Path, number: int, name: str, swept: list[str]) -> JobRecord:
    """The state of a job; waiting, where there is no record of it."""
    return _read(record_file(sweep, name)) or JobRecord(number, name, swept)


def read_records(sweep: Path) -> list[JobRecord]:
    """The states of all jobs, in their order."""
    records = [_read(path) for path in sweep.glob(f"{JOBS}/*.json")]
    return sorted((record for record in records if record is not None), key=lambda record: record.number)


def _read(path: Path) -> JobRecord | None:
    try:
        return JobRecord(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None  # not there, or damaged: as if the job had never been started
