"""hydra/launcher=joblib: several jobs at once on this machine, the cores shared out among them."""

from collections.abc import Sequence

from riginv.launch.apart import Job, run_apart
from riginv.launch.launching import JobsLauncher


class JoblibLauncher(JobsLauncher):
    """Several jobs at once on this machine.

    Args:
        n_jobs: so many; -1: as many as there are cores, or jobs.
        threads: of each job; None: the cores shared out.
    """

    package = name = "joblib"

    def __init__(self, n_jobs: int = -1, threads: int | None = None) -> None:
        self.n_jobs, self.threads = n_jobs, threads

    def run_all(self, jobs: Sequence[Job]) -> None:
        """Each job waits for its own process in a thread of this one."""
        from joblib import Parallel, cpu_count, delayed  # Hydra loads this file for every command

        at_once, threads = shared_out(cpu_count(), len(jobs), self.n_jobs)
        Parallel(n_jobs=at_once, prefer="threads", batch_size=1)(
            delayed(run_apart)(job, self.threads or threads) for job in jobs
        )


def shared_out(cores: int, jobs: int, wanted: int) -> tuple[int, int]:
    """How many jobs run at once, and how many threads each may use.

    Args:
        cores: that are there.
        jobs: to be run.
        wanted: at once; below 0: one for each core.
    """
    at_once = min(jobs, wanted if wanted > 0 else cores)
    return at_once, max(1, cores // at_once)
