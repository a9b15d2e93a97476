"""hydra/launcher=ray: jobs on a Ray cluster, or on this machine by Ray."""

from collections.abc import Sequence
from typing import Any

from omegaconf import DictConfig, OmegaConf

from riginv.errors import InputError
from riginv.launch.job_launcher import JobsLauncher
from riginv.launch.job_process import Job, run_in_subprocess
from riginv.runs.run_folder import resolved


class RayLauncher(JobsLauncher):
    """Jobs as tasks of Ray.

    Args:
        init: arguments of `ray.init`: `address` names a cluster ("auto": that of this machine; None: a new one on this
            machine).
        remote: resources of each job, as arguments of `ray.remote`: `num_cpus`, `num_gpus`, `resources`, `max_retries`.
    """

    package = name = "ray"

    def __init__(self, init: DictConfig, remote: DictConfig) -> None:
        self.init: dict[str, Any] = resolved(OmegaConf.create(init))
        self.remote: dict[str, Any] = resolved(OmegaConf.create(remote))

    def run_all(self, jobs: Sequence[Job]) -> None:
        """Run each job as a task; a job whose machine is lost resumes on another.

        Raises:
            InputError: there is no cluster at that address.
        """
        import ray  # Hydra loads this file for every command

        ours = not ray.is_initialized()
        if ours:
            try:
                ray.init(**self.init)
            except ConnectionError as error:
                reason = str(error).splitlines()[0]
                raise InputError(
                    f"hydra.launcher.init.address={self.init['address']}: no Ray cluster there: {reason}"
                ) from None
        try:
            task = ray.remote(**self.remote)(run_in_subprocess)
            running = [task.remote(job, max(1, int(self.remote["num_cpus"]))) for job in jobs]
            while running:
                ended, running = ray.wait(running)
                for one in ended:
                    try:
                        ray.get(one)
                    except ray.exceptions.RayError:
                        continue  # its record has no end: the launcher says so
        finally:
            if ours:
                ray.shutdown()
