"""hydra/launcher=joblib: parallel jobs on this machine, which share its cores."""

from collections.abc import Sequence

from riginv.launch.job_launcher import JobsLauncher
from riginv.launch.job_process import Job, run_in_subprocess


class JoblibLauncher(JobsLauncher):
    """Parallel jobs on this machine.

    Args:
        n_jobs: number of parallel jobs; -1: the number of cores or of jobs.
        threads: of each job; None: an equal share of the cores.
    """

    package = name = "joblib"

    def __init__(self, n_jobs: int = -1, threads: int | None = None) -> None:
        self.n_jobs, self.threads = n_jobs, threads

    def run_all(self, jobs: Sequence[Job]) -> None:
        """Each job waits for its own process in a thread of this one."""
        from joblib import Parallel, cpu_count, delayed  # Hydra loads this file for every command

        parallel, threads = share_cores(cpu_count(), len(jobs), self.n_jobs)
        Parallel(n_jobs=parallel, prefer="threads", batch_size=1)(
            delayed(run_in_subprocess)(job, self.threads or threads) for job in jobs
        )


def share_cores(cores: int, jobs: int, wanted: int) -> tuple[int, int]:
    """Number of parallel jobs, and of threads for each.

    Args:
        wanted: parallel jobs; below 0: one per core.
    """
    parallel = min(jobs, wanted if wanted > 0 else cores)
    return parallel, max(1, cores // parallel)
