"""Base class of the sweep launchers: runs each job as a command line in its own process.

A launcher is a plug-in of Hydra (`hydra_plugins/riginv_launchers`) that says where jobs run; `hydra/launcher=NAME` chooses it.
"""

import os
from abc import abstractmethod
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn, JobStatus, setup_globals
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, open_dict
from rich.console import Console

from riginv.errors import InputError
from riginv.launch.job_process import Job
from riginv.launch.sweep_folder import swept
from riginv.launch.sweep_progress import SweepProgress
from riginv.launch.sweep_record import FINISHED

OF_THE_SWEEP = (
    "hydra.mode",
    "hydra.run.dir",
    "hydra.sweep.",
    "hydra/launcher",
    "hydra.launcher.",
    "hydra/sweeper",
    "hydra.sweeper.",
)


class JobsLauncher(Launcher):
    """Runs each job as a command line of its own; subclasses implement `run_all`."""

    package = ""  # that must be installed
    name = ""  # as in hydra/launcher=NAME

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Called by Hydra with the task of a command.

        Raises:
            InputError: the package that this launcher needs is not installed.
        """
        if find_spec(self.package) is None:
            raise InputError(
                f"hydra/launcher={self.name} needs the package {self.package}, which is not installed: "
                "pip install 'riginv[sweeps]', or omit hydra/launcher to run one job after the other"
            )
        job: Any = task_function.__self__  # type: ignore[attr-defined]  # a method of `riginv.launch.command`
        self.context, self.module, self.config = hydra_context, job.module, config

    @abstractmethod
    def run_all(self, jobs: Sequence[Job]) -> None:
        """Run every job by `run_in_subprocess`; the record of one that cannot be run stays without an end."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Called by Hydra to run a batch of jobs; the outcome of each is in its record."""
        setup_globals()
        jobs = [self._job(overrides, initial_job_idx + index) for index, overrides in enumerate(job_overrides)]
        missing = [job for job in jobs if job.record().state != FINISHED]
        for job in missing:
            job.record().waits(job.sweep)
        self._announce(jobs, missing)
        if missing:
            with SweepProgress(missing):
                self.run_all(missing)
                for job in missing:
                    record = job.record()
                    if not record.has_ended:
                        record.ended(job.sweep, record.seconds, "the machine or the process that ran it was lost")
        return [_done(overrides) for overrides in job_overrides]

    def _announce(self, jobs: list[Job], missing: list[Job]) -> None:
        already = f"; {len(jobs) - len(missing)} finished before" if len(missing) < len(jobs) else ""
        Console(stderr=True).print(
            f"{len(missing)} jobs by {self.name}{already}, in {jobs[0].sweep}", soft_wrap=True, highlight=False
        )

    def _job(self, overrides: Sequence[str], number: int) -> Job:
        config = self.context.config_loader.load_sweep_config(self.config, list(overrides))
        with open_dict(config):
            config.hydra.job.id, config.hydra.job.num = str(number), number
        sweep, name = Path(os.path.abspath(config.hydra.sweep.dir)), str(config.hydra.sweep.subdir)
        folder = str(sweep / name).replace("'", "\\'")
        kept = [text for text in config.hydra.overrides.hydra if not text.startswith(OF_THE_SWEEP)]
        configs = [source.path for source in config.hydra.runtime.config_sources if source.provider == "command-line"]
        return Job(
            module=self.module,
            arguments=[
                *(f"--config-dir={path}" for path in configs),
                *kept,
                *overrides,
                f"hydra.run.dir='{folder}'",
                "hydra.mode=RUN",
            ],
            sweep=sweep,
            number=number,
            name=name,
            swept=swept(sweep, overrides),
            directory=Path.cwd(),
            can_resume="resume" in config,
        )


def _done(overrides: Sequence[str]) -> JobReturn:
    done = JobReturn(overrides=list(overrides), status=JobStatus.COMPLETED)
    done.return_value = None
    return done
