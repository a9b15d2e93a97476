"""hydra/launcher=submitit_slurm: jobs as a SLURM array; hydra/launcher=submitit_local: the same without a queue."""

from collections.abc import Sequence
from typing import Any

from omegaconf import ListConfig, OmegaConf

from riginv.launch.job_launcher import JobsLauncher
from riginv.launch.job_process import Job, run_in_subprocess

GENERAL = "name timeout_min mem_gb nodes tasks_per_node cpus_per_task gpus_per_node stderr_to_stdout".split()


class SubmititLauncher(JobsLauncher):
    """Jobs by submitit.

    Args:
        cluster: slurm or local.
        max_num_timeout: how often a job that exceeds its time limit is queued again; it resumes.
        parameters: of the queue: the general ones of submitit, or those of the cluster (partition, setup ...).
    """

    package = "submitit"

    def __init__(self, cluster: str, max_num_timeout: int, **parameters: Any) -> None:
        self.cluster, self.max_num_timeout = cluster, max_num_timeout
        self.name = f"submitit_{cluster}"
        plain = {
            key: OmegaConf.to_container(value) if OmegaConf.is_config(value) or isinstance(value, ListConfig) else value
            for key, value in parameters.items()
        }
        self.parameters = {key if key in GENERAL else f"{cluster}_{key}": value for key, value in plain.items()}

    def run_all(self, jobs: Sequence[Job]) -> None:
        """Submit all jobs as one array, and wait for them; the array continues if this process ends."""
        from submitit.core.utils import UncompletedJobError  # Hydra loads this file for every command

        for submitted in self.submit(jobs):
            try:
                submitted.result()
            except UncompletedJobError:
                continue  # its record has no end: the launcher says so

    def submit(self, jobs: Sequence[Job]) -> list[Any]:
        """Submit all jobs as one array; their handles of submitit."""
        import submitit

        executor = submitit.AutoExecutor(
            jobs[0].sweep / "submitit" / "%j", cluster=self.cluster, slurm_max_num_timeout=self.max_num_timeout
        )
        executor.update_parameters(**self.parameters)
        return executor.map_array(Requeued(), jobs, [self.parameters.get("cpus_per_task")] * len(jobs))


class Requeued:
    """`run_in_subprocess` for submitit: a job that exceeds its time limit is queued again, and resumes by its record."""

    def __call__(self, job: Job, threads: int | None) -> None:
        run_in_subprocess(job, threads)

    def checkpoint(self, job: Job, threads: int | None) -> Any:
        """The job to queue again, for submitit."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self, job, threads)
