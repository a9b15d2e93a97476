"""Several processes train what one trains: the same batches, weights and figures; where one dies none is left behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from safetensors.torch import load_file
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from riginv.config.typed import to_typed
from riginv.errors import InputError
from riginv.runs.run_folder import plain_config
from riginv.training.config import TrainConfig
from riginv.training.devices import Process, this_process
from tests.config.test_bad_input import refused
from tests.conftest import ROOT, SMALL
from tests.training.test_resume import restore_sigint, same_weights, saved_step

TWO = ["trainer=ddp", "trainer.accelerator=cpu"]
UNEVEN = ["data.batch_size=7", "evaluation.validation_poses=5"]
PLACES = ("RANK", "LOCAL_RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT", "TORCHELASTIC_RUN_ID", "RIGINV_LAUNCHER_PID")


@pytest.fixture(autouse=True)
def on_its_own(monkeypatch):
    """Nothing around the tests has started processes; those that they start find riginv, and take one core each."""
    for name in [*PLACES, *(name for name in os.environ if name.startswith("SLURM_"))]:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")


def composed(*arguments: str) -> dict:
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return plain_config(compose("train", list(arguments)))


def process_of(config: dict) -> Process:
    settings = to_typed(config, TrainConfig)
    return this_process(settings.trainer, settings.data.batch_size)


def curves(folder: Path) -> dict[str, list[float]]:
    events = EventAccumulator(str(folder)).Reload()
    return {tag: [event.value for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}


def names(folder: Path) -> set[str]:
    paths = (path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return {path.partition("events.")[0] + "events" if "events." in path else path for path in paths}


def apart(one: Path, other: Path) -> float:
    """The largest difference between two bundles' weights, over the largest of each; but for those that have no effect."""
    a, b = (load_file(folder / "bundle/weights.safetensors") for folder in (one, other))
    assert a.keys() == b.keys()
    learned = [key for key in a if key != "stages.0.network.2.bias"]  # the anchor takes it away: its gradient is rounding
    return max(float((a[key] - b[key]).abs().max() / a[key].abs().max().clamp_min(1e-6)) for key in learned)


def test_two_processes_train_what_one_trains_with_uneven_shares(run):
    one = run("train", *UNEVEN, folder="one")
    two = run("train", *UNEVEN, *TWO, folder="two")
    assert one.code == two.code == 0, two.text
    assert apart(one.folder, two.folder) < 1e-4
    assert names(one.folder) == names(two.folder)
    assert two.text.count("Evaluated on the true rig") == 1 and two.text.count("step 6/12") == 1
    alone, shared = curves(one.folder), curves(two.folder)
    assert alone.keys() == shared.keys()
    for tag, values in alone.items():
        if not tag.startswith("result/"):
            assert shared[tag] == pytest.approx(values, rel=1e-3), tag
    for key, value in one.metrics.items():
        if key.endswith("error_mm"):
            assert two.metrics[key] == pytest.approx(value, rel=1e-3), key


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["trainer=ddp", "data.batch_size=1"], "data.batch_size is 1"),
        (["trainer=ddp", "trainer.num_nodes=2"], "use trainer=slurm under srun, or torchrun"),
        (["trainer=slurm"], "start the command with srun"),
        (["trainer.devices=0"], "trainer.devices is 0"),
        (["trainer.num_nodes=half"], "trainer.num_nodes is 'half'"),
        (["trainer.precision=16-mixed"], "trainer.precision is '16-mixed'"),
        (["trainer.compile=1"], "trainer.compile is 1"),
    ],
)
def test_a_mistake_is_named_before_anything_starts(run, arguments, says):
    outcome = run("train", *arguments)
    refused(outcome, says)
    assert not outcome.folder.exists()


def test_a_sweep_over_several_devices_is_refused_with_the_reason(run, tmp_path):
    swept = run("train", "-m", *TWO, "seed=0,1", f"hydra.sweep.dir={tmp_path / 'sweep'}")
    assert swept.code == 1 and "Traceback" not in swept.text
    assert "trainer.devices=2 cannot be part of a sweep (-m)" in " ".join(swept.text.split())
    assert not list((tmp_path / "sweep").rglob("checkpoints"))


def test_the_trainers_compose_to_what_they_say(monkeypatch):
    gpu = composed("trainer=gpu")["trainer"]
    assert (gpu["accelerator"], gpu["devices"], gpu["max_steps"], gpu["starts_processes"]) == ("gpu", 1, 40000, True)
    ddp = composed("trainer=ddp", "trainer.devices=4")
    assert (ddp["trainer"]["accelerator"], ddp["trainer"]["max_steps"]) == ("auto", ddp["model"]["cpu_steps"])
    assert process_of(ddp).count == 4 and process_of(ddp).must_start_others
    monkeypatch.setenv("SLURM_NTASKS_PER_NODE", "4")
    monkeypatch.setenv("SLURM_NNODES", "2")
    slurm = composed("trainer=slurm")["trainer"]
    assert (slurm["accelerator"], slurm["devices"], slurm["num_nodes"], slurm["starts_processes"]) == ("gpu", 4, 2, False)
    for name in ("auto", "cpu", "gpu", "ddp", "slurm"):
        config = composed(f"trainer={name}")
        to_typed(config, TrainConfig)
        assert config["trainer"].keys() == gpu.keys()


def test_processes_that_srun_has_started_know_each_other(monkeypatch):
    job = {"NTASKS": 8, "NTASKS_PER_NODE": 4, "NNODES": 2, "PROCID": 5, "LOCALID": 1, "NODEID": 1, "JOB_ID": 77}
    for name, value in job.items():
        monkeypatch.setenv(f"SLURM_{name}", str(value))
    process = process_of(composed("trainer=slurm"))
    assert (process.rank, process.count, process.must_start_others, process.shows) == (5, 8, False, False)
    assert process.environment.local_rank() == 1 and not process.environment.auto_requeue
    with pytest.raises(InputError, match="8 processes were started, trainer.devices=3 x trainer.num_nodes=2 is 6"):
        process_of(composed("trainer=slurm", "trainer.devices=3"))
    monkeypatch.delenv("SLURM_NTASKS_PER_NODE")
    with pytest.raises(InputError, match="ntasks-per-node"):
        process_of(composed("trainer=slurm"))


def test_processes_started_apart_need_a_folder_that_all_name(run, monkeypatch):
    for name, value in {"TORCHELASTIC_RUN_ID": "none", "RANK": "1", "LOCAL_RANK": "1", "WORLD_SIZE": "2"}.items():
        monkeypatch.setenv(name, value)
    refused(run("train", *TWO, "hydra.sweep.dir=x"), "need one folder: set hydra.run.dir=DIR")


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        ["model=forward"],
        ["model=holden"],
        ["model/network=direct"],
        ["model/network=paper"],
        ["data.stored_poses=50"],
        ["model=forward", "model/network=paper_forward"],
        ["model/schedule=plateau", "model.schedule.patience=0", "model.optimizer.lr=0.05"],
        ["rig=black_box", "data.black_box_poses=50"],
        ["noise.vertex_mm=0.5", "noise.smooth_mm=1"],
    ],
    ids=lambda arguments: arguments[-1],
)
def test_every_model_trains_in_two_processes(run, arguments):
    """By steepest descent: Adam makes full steps of what is rounding alone, in weights that nothing depends on."""
    descent = ["model.optimizer._target_=torch.optim.SGD", "surrogate.optimizer._target_=torch.optim.SGD"]
    one = run("train", *UNEVEN, *descent, *arguments, folder="one")
    two = run("train", *UNEVEN, *TWO, *descent, *arguments, folder="two")
    assert one.code == two.code == 0, two.text
    assert apart(one.folder, two.folder) < 1e-3
    assert names(one.folder) == names(two.folder)


@pytest.mark.slow
def test_more_processes_than_validation_poses(run):
    one = run("train", "evaluation.validation_poses=2", folder="one")
    three = run("train", "evaluation.validation_poses=2", *TWO, "trainer.devices=3", folder="three")
    assert one.code == three.code == 0, three.text
    assert apart(one.folder, three.folder) < 1e-4
    alone, shared = curves(one.folder), curves(three.folder)
    for tag in (tag for tag in alone if tag.startswith("val/")):
        assert shared[tag] == pytest.approx(alone[tag], rel=1e-3), tag


@pytest.mark.slow
def test_a_mistake_that_only_the_processes_find_is_said_once(run):
    outcome = run("train", *TWO, "rig=surrogate", "rig.bundle=nowhere")
    refused(outcome, "nowhere: no bundle there")
    assert not outcome.folder.exists()
    refused(run("train", *TWO, "model.optimizer.lr=1e30", "trainer.max_steps=50"), "the loss became")
    refused(run("train", *TWO, "model/network=paper_batch_normalised", folder="other"), "normalises over a batch")


LONGER = ["trainer.max_steps=150", "data.steps_per_epoch=40", "checkpoint.every_n_steps=7", *UNEVEN, *TWO]


def start(folder: Path, *more: str) -> subprocess.Popen:
    """Start a run in two processes."""
    return subprocess.Popen(
        [sys.executable, "-m", "riginv.train", *SMALL, *LONGER, f"hydra.run.dir={folder}", *more],
        cwd=folder.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=restore_sigint,
    )


def children(process: subprocess.Popen) -> list[int]:
    """The processes that a process has started, in their order."""
    return [int(pid) for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]


def gone(pid: int) -> bool:
    return not Path(f"/proc/{pid}").exists()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="finds the processes to kill in /proc")
def test_whichever_process_is_killed_the_others_end_and_a_resumed_run_ends_the_same(run, tmp_path):
    whole = run("train", *LONGER, folder="whole")
    assert whole.code == 0, whole.text
    broken, step = tmp_path / "broken", 7
    for victim, how in (
        (1, signal.SIGKILL),
        (0, signal.SIGKILL),
        (None, signal.SIGKILL),
        (None, signal.SIGINT),
        (1, signal.SIGTERM),
    ):
        process = start(broken, *(["resume=true"] if broken.exists() else []))
        while process.poll() is None and saved_step(broken) <= step:
            time.sleep(0.02)
        assert process.poll() is None, process.communicate()[0]
        both = children(process)
        assert len(both) == 2
        os.kill(process.pid if victim is None else both[victim], how)
        said = process.communicate(timeout=60)[0]
        step = saved_step(broken) + 7
        assert process.returncode != 0 and "Traceback" not in said
        if process.returncode > 0:
            assert "resume=true" in said, said
        until = time.monotonic() + 10
        while not all(map(gone, both)) and time.monotonic() < until:
            time.sleep(0.1)
        assert all(map(gone, both)), "a process was left behind"
    resumed = run("train", *LONGER, "resume=true", folder="broken")
    assert resumed.code == 0, resumed.text
    assert same_weights(whole.folder, broken)


@pytest.mark.slow
def test_a_run_goes_on_with_another_number_of_processes(run, tmp_path):
    whole = run("train", *LONGER, "trainer.devices=1", folder="whole")
    broken = tmp_path / "broken"
    process = start(broken)
    while process.poll() is None and saved_step(broken) <= 20:
        time.sleep(0.02)
    process.kill()
    process.communicate()
    resumed = run("train", *LONGER, "trainer.devices=1", "resume=true", folder="broken")
    assert whole.code == resumed.code == 0, resumed.text
    assert apart(whole.folder, broken) < 1e-2


@pytest.mark.slow
def test_processes_of_srun_train_what_one_process_trains(run, tmp_path):
    """As srun starts them: the variables that SLURM documents, on the CPU."""
    one = run("train", *UNEVEN, folder="one")
    many = tmp_path / "many"
    job = {"NTASKS": 2, "NTASKS_PER_NODE": 2, "NNODES": 1, "NODEID": 0, "JOB_ID": os.getpid(), "NODELIST": "127.0.0.1"}
    command = [sys.executable, "-m", "riginv.train", *SMALL, *UNEVEN, "trainer=slurm", "trainer.accelerator=cpu"]
    command += ["trainer.max_steps=12", f"hydra.run.dir={many}"]
    shared = {**os.environ, **{f"SLURM_{name}": str(value) for name, value in job.items()}}
    tasks = [
        subprocess.Popen(
            command,
            env={**shared, "SLURM_PROCID": str(rank), "SLURM_LOCALID": str(rank)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for rank in range(2)
    ]
    first, second = (task.communicate(timeout=300)[0] for task in tasks)
    assert [task.returncode for task in tasks] == [0, 0], first + second
    assert "Evaluated on the true rig" in first and not second
    assert apart(one.folder, many) < 1e-4 and names(one.folder) == names(many)


@pytest.mark.slow
def test_the_default_face_in_two_processes(run):
    face = ["trainer.max_steps=30", "data.steps_per_epoch=15", "evaluation.test_poses=40", "evaluation.validation_poses=16"]
    face += ["pictures.every_n_validations=null", "pictures.final=false"]
    one = run("train", *face, folder="one", small=False)
    two = run("train", *face, *TWO, folder="two", small=False)
    assert one.code == two.code == 0, two.text
    for key, value in one.metrics.items():
        if key.endswith("mean_vertex_error_mm"):
            assert two.metrics[key] == pytest.approx(value, rel=0.02), key
