"""Where the jobs of a sweep run: each apart, so that none hides another, by joblib, Ray and submitit."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from omegaconf import OmegaConf

from hydra_plugins.riginv_launchers.joblib_launcher import JoblibLauncher, share_cores
from riginv.config.messages import CONFIGS
from riginv.errors import InputError
from riginv.launch.job_launcher import JobsLauncher
from riginv.launch.job_process import Job, run_in_subprocess
from riginv.launch.sweep_record import record_file
from riginv.launch.sweep_rows import sweep_rows, write_tables
from tests.conftest import ROOT


@pytest.fixture(autouse=True)
def _jobs_find_the_tests(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))


def jobs(sweep: Path, *what: str) -> list[Job]:
    """Jobs that do what their arguments say, such as `measure error=3`."""
    made = []
    for number, text in enumerate(what):
        name, swept = f"{number:02d}_{text.replace(' ', '_')}", [f"do={text.split()[0]}", *text.split()[1:]]
        arguments = [*swept, f"hydra.run.dir='{sweep / name}'"]
        made.append(Job("tests.support.sweep_worker", arguments, sweep, number, name, swept, ROOT, can_resume=True))
    return made


def starts(job: Job) -> list[list[str]]:
    """Of each start: resume, threads, process, seconds."""
    return [line.split() for line in (job.sweep / job.name / "starts.txt").read_text().splitlines()]


def states(made: list[Job]) -> list[str]:
    return [job.record().state for job in made]


def test_joblib_lets_no_job_hide_another(tmp_path):
    pytest.importorskip("joblib", reason="joblib is not installed: pip install 'riginv[sweeps]'")
    made = jobs(tmp_path, "measure error=3", "die", "refuse", "break", "measure error=2", "nothing")
    JoblibLauncher(n_jobs=2, threads=3).run_all(made)
    assert states(made) == ["finished", "failed", "failed", "failed", "finished", "finished"]
    assert [job.record().why for job in made[1:4]] == [
        "its process was killed by signal 9, possibly out of memory",
        "the mesh is not there",
        "KeyError: 'a fault of ours'",
    ]
    assert "Traceback" in (tmp_path / made[3].name / "failure.txt").read_text()
    assert {start[1] for job in made for start in starts(job)} == {"3"}

    rows = sweep_rows(tmp_path)  # the least error first, what left no metrics after it, what failed last
    assert [row["state"] for row in rows] == ["finished"] * 3 + ["failed"] * 3
    assert [row.get("error") for row in rows[:3]] == ["2", "3", None]
    write_tables(tmp_path, rows)
    text = (tmp_path / "sweep.md").read_text()
    assert text.startswith("| do | error | state | rig poses | took s |") and "| measure | 2 | finished | 2 |" in text


def test_what_finished_is_left_alone_and_what_was_started_goes_on(tmp_path):
    made = jobs(tmp_path, "nothing", "die_once")
    for _ in range(2):
        for job in made:
            run_in_subprocess(job)
    assert states(made) == ["finished", "finished"]
    assert [start[0] for start in starts(made[0])] == ["false"]
    assert [start[0] for start in starts(made[1])] == ["false", "true"]
    assert made[1].record().starts == 2 and made[1].record().why == ""
    assert not (tmp_path / made[1].name / "failure.txt").exists()


def test_a_damaged_record_is_as_good_as_none(tmp_path):
    made = jobs(tmp_path, "nothing")
    run_in_subprocess(made[0])
    record_file(tmp_path, made[0].name).write_text('{"number": 0, "na')
    run_in_subprocess(made[0])
    assert states(made) == ["finished"] and len(starts(made[0])) == 2


def test_a_sweep_that_is_killed_takes_its_jobs_with_it(tmp_path):
    job = jobs(tmp_path, "nothing sleep=60")[0]
    text = f"from pathlib import *; from riginv.launch.job_process import Job, run_in_subprocess; run_in_subprocess({job!r})"
    with subprocess.Popen([sys.executable, "-c", text], cwd=ROOT) as starter:
        wait_until((tmp_path / job.name / "starts.txt").is_file, 60)
        process = int(starts(job)[0][2])
        starter.send_signal(signal.SIGKILL)
    wait_until(lambda: not alive(process), 10)
    assert states([job]) == ["running"]  # nobody was left to say more


def test_jobs_that_run_at_once_share_the_cores():
    assert share_cores(cores=2, jobs=6, wanted=-1) == (2, 1)
    assert share_cores(cores=16, jobs=6, wanted=2) == (2, 8)
    assert share_cores(cores=16, jobs=3, wanted=-1) == (3, 5)
    assert share_cores(cores=2, jobs=6, wanted=4) == (4, 1)
    assert share_cores(cores=8, jobs=1, wanted=-1) == (1, 8)


class Missing(JobsLauncher):
    package, name = "a_package_that_nobody_has", "missing"

    def run_all(self, jobs):
        raise AssertionError("it must not get here")


def test_a_launcher_whose_package_is_missing_says_what_to_install():
    with pytest.raises(InputError, match=r"hydra/launcher=missing needs the package a_package.*pip install 'riginv\[sweeps\]'"):
        Missing().setup(hydra_context=None, task_function=None, config=None)


def test_submitit_runs_jobs_on_this_machine(tmp_path):
    pytest.importorskip("submitit", reason="submitit is not installed: pip install 'riginv[sweeps]'")
    made = jobs(tmp_path, "nothing", "die")
    launcher(tmp_path, "submitit_local", "hydra.launcher.cpus_per_task=2").run_all(made)
    assert states(made) == ["finished", "failed"]
    assert {start[1] for job in made for start in starts(job)} == {"2"}


def test_submitit_asks_slurm_for_what_the_config_says(tmp_path, monkeypatch):
    pytest.importorskip("submitit", reason="submitit is not installed: pip install 'riginv[sweeps]'")
    programs = tmp_path / "bin"  # in SLURM's place: keeps what it is handed
    programs.mkdir()
    for name, text in {"sbatch": f'cp "$1" {tmp_path}/script; echo Submitted batch job 7', "srun": "true"}.items():
        (programs / name).write_text(f"#!/bin/sh\n{text}\n")
        (programs / name).chmod(0o755)
    monkeypatch.setenv("PATH", os.pathsep.join([str(programs), os.environ["PATH"]]))
    slurm = launcher(
        tmp_path, "submitit_slurm", "hydra.launcher.partition=farm", "hydra.launcher.setup=[module load python]",
        "+hydra.launcher.additional_parameters.nice=5", "hydra.launcher.array_parallelism=2",
    )  # fmt: skip
    assert [job.job_id for job in slurm.submit(jobs(tmp_path, "nothing", "nothing", "nothing"))] == ["7_0", "7_1", "7_2"]
    script = (tmp_path / "script").read_text()
    for line in ("partition=farm", "array=0-2%2", "nice=5", "cpus-per-task=2", "time=120", "mem=8GB", "job-name=riginv-train"):
        assert f"#SBATCH --{line}\n" in script, script
    assert "\nmodule load python\n" in script


@pytest.mark.parametrize("name", ["joblib", "ray", "submitit_local", "submitit_slurm"])
def test_every_launcher_composes(tmp_path, name):
    assert launcher(tmp_path, name).name == name


@pytest.mark.slow
def test_a_ray_cluster_spreads_jobs_over_its_nodes(tmp_path):
    with ray_cluster(head_cores=1) as cluster:
        for _ in range(2):
            cluster.add_node(num_cpus=1)
        made = jobs(tmp_path, "measure error=1 sleep=6", "die", "refuse", "nothing sleep=6", "nothing sleep=6")
        launcher(tmp_path, "ray", f"hydra.launcher.init.address='{cluster.address}'").run_all(made)
    assert states(made) == ["finished", "failed", "failed", "finished", "finished"]
    long = [made[0], made[3], made[4]]
    ended = [float((tmp_path / job.name / "ended.txt").read_text()) for job in long]
    assert max(float(starts(job)[0][3]) for job in long) < min(ended)  # three at once, where each node has one core
    assert {start[1] for job in made for start in starts(job)} == {"1"}


@pytest.mark.slow
def test_a_job_whose_ray_node_is_lost_goes_on_at_another(tmp_path):
    with ray_cluster(head_cores=0) as cluster:
        lost = cluster.add_node(num_cpus=1)
        made = jobs(tmp_path, "nothing sleep=8")
        by_ray = launcher(tmp_path, "ray", f"hydra.launcher.init.address='{cluster.address}'")
        running = threading.Thread(target=by_ray.run_all, args=(made,))
        running.start()
        wait_until((tmp_path / made[0].name / "starts.txt").is_file, 120)
        cluster.add_node(num_cpus=1)  # Ray wants the main thread for that
        cluster.remove_node(lost, allow_graceful=False)
        running.join()
    assert states(made) == ["finished"]
    assert [start[0] for start in starts(made[0])] == ["false", "true"]
    assert not alive(int(starts(made[0])[0][2]))


@contextmanager
def ray_cluster(head_cores: int) -> Iterator[Any]:
    """A cluster of several Ray nodes on this machine."""
    pytest.importorskip("ray", reason="ray is not installed: pip install 'riginv[sweeps]'")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": head_cores, "include_dashboard": False})
    try:
        yield cluster
    finally:
        cluster.shutdown()


def launcher(sweep: Path, name: str, *overrides: str) -> JobsLauncher:
    """A launcher as Hydra builds it from the config of riginv.train."""
    from hydra import compose, initialize_config_dir

    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        given = [f"hydra/launcher={name}", f"hydra.sweep.dir={sweep}", *overrides]
        config = compose("train", given, return_hydra_config=True)
        part = OmegaConf.create(OmegaConf.to_container(config.hydra.launcher, resolve=True))
    return Plugins.instance()._instantiate(part)


def wait_until(holds, seconds: float) -> None:
    until = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < until, "it took too long"
        time.sleep(0.05)


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{process}/stat").read_text().split()[2] != "Z" if Path("/proc").is_dir() else True
