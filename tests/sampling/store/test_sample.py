"""riginv.sample as a user types it: killed, stopped, spread over jobs, and trained from."""

import contextlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import zarr

from riginv.sampling.store.checking import examine
from riginv.sampling.store.filling import fill
from riginv.sampling.store.location import StoreLocation
from riginv.sampling.store.store import PoseStore
from riginv.sampling.store.worker import ChunkWorkers
from tests.conftest import ROOT
from tests.sampling.store.support import PLAN, arrays, flip, plan, same
from tests.training.test_resume import kill_after, restore_sigint, same_weights, saved_step
from tests.training.test_resume import start as start_training

CONFIGS = f"--config-dir={ROOT / 'tests/conf'}"
TOY = [CONFIGS, "rig=toy", "samples=60000", "chunk=500", "seed=3"]
LITTLE = [CONFIGS, "rig=toy", "samples=2000", "chunk=100", "jobs=1"]


def start(out: Path, *more: str, before=restore_sigint) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "riginv.sample", *TOY, f"out={out}", *more],
        cwd=out.parent,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=before,
    )


def complete(out: Path) -> int:
    return len(list((out / "ledger/c").glob("*/0")))


def test_killed_and_given_again_it_ends_in_the_same_arrays(tmp_path, run):
    whole, broken = tmp_path / "whole.zarr", tmp_path / "broken.zarr"
    made = run("sample", *TOY, "jobs=1", f"out={whole}")
    assert made.code == 0 and "finished" in made.text, made.text
    process = start(broken, "jobs=2")
    wait_for(process, broken, chunks=5)
    workers = children(process.pid)
    process.kill()
    process.communicate()
    assert len(workers) == 2 and ended(workers)
    process = start(broken, "jobs=1")
    wait_for(process, broken, chunks=45)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=60)[0]
    assert "the same command goes on" in said and "Traceback" not in said
    assert 45 <= complete(broken) < 120
    again = run("sample", *TOY, "jobs=1", f"out={broken}")
    assert again.code == 0, again.text
    assert same(whole, broken)
    assert not list(broken.rglob("*.partial"))
    assert sorted(path.name for path in tmp_path.glob("*.zarr*")) == ["broken.zarr", "whole.zarr"]
    done = run("sample", *TOY, f"out={broken}")
    assert done.code == 0 and "there was nothing to do" in done.text


def wait_for(process: subprocess.Popen, out: Path, chunks: int) -> None:
    while process.poll() is None and complete(out) < chunks:
        time.sleep(0.005)
    assert process.poll() is None, process.communicate()[0]


def children(parent: int) -> list[str]:
    """The processes that a process has started."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            if int(stat.read_text().rpartition(")")[2].split()[1]) == parent:
                found.append(stat.parent.name)
    return found


def ended(pids: list[str]) -> bool:
    """Whether processes end, within seconds."""
    for _ in range(100):
        if not any(Path(f"/proc/{pid}").exists() for pid in pids):
            return True
        time.sleep(0.05)
    return False


@pytest.mark.slow
def test_a_worker_that_dies_is_replaced(tmp_path):
    config = {**PLAN, "out": str(tmp_path / "s.zarr")}
    fill(plan({**config, "shard": "12/13"}))  # one chunk, to begin it
    with ChunkWorkers(config["out"], plan(config).rig, plan(config).sampler, 1) as workers:
        chunks = workers.make(range(12))
        assert next(chunks) == 0
        (first,) = workers.pool.process_ids()
        os.kill(first, signal.SIGKILL)
        assert list(chunks) == list(range(1, 12)) and workers.pool.process_ids() != [first]
    assert examine(PoseStore.find(StoreLocation(config["out"]))).complete


def test_verify_names_what_is_missing_and_damaged(tmp_path, run):
    out = tmp_path / "s.zarr"
    assert run("sample", *LITTLE, f"out={out}").code == 0
    good = run("sample", f"verify={out}")
    assert good.code == 0 and "every chunk matches its checksum" in good.text
    before = arrays(out)
    shutil.rmtree(out / "ledger/c/4")
    flip(out / "coefficients/c/7/0")
    (out / "controls/c/9/0").unlink()
    bad = run("sample", f"verify={out}")
    words = " ".join(bad.text.split())
    assert bad.code == 1 and "1 chunks: 4" in words, bad.text
    assert "chunk 7 of 'coefficients' is damaged" in words and "chunk 9 of 'controls' is missing" in words
    mended = run("sample", *LITTLE, f"out={out}")
    assert mended.code == 0 and "300 poses" in mended.text, mended.text
    assert all(np.array_equal(values, before[name]) for name, values in arrays(out).items())
    assert run("sample", f"verify={out}").code == 0
    assert "there is no store" in run("sample", f"verify={tmp_path / 'none.zarr'}").text


@pytest.mark.parametrize("jobs", ["jobs=1", pytest.param("jobs=2", marks=pytest.mark.slow)])
def test_a_full_disk_is_one_sentence_and_loses_nothing(tmp_path, run, jobs):
    def little_room() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))  # as a full disk: writing fails in the middle of a file

    out = tmp_path / "s.zarr"
    little = ["samples=4000", "chunk=2000"]
    process = start(out, *little, jobs, before=little_room)
    said = process.communicate(timeout=60)[0]
    assert process.returncode == 1 and "cannot be written: File too large" in said and "Traceback" not in said, said
    assert not list(out.rglob("*.partial")) and complete(out) == 0
    assert run("sample", *TOY, *little, "jobs=1", f"out={out}").code == 0
    assert run("sample", f"verify={out}").code == 0


def test_a_path_through_a_file_is_one_sentence(tmp_path, run):
    (tmp_path / "file").write_text("")
    ended = run("sample", *LITTLE, f"out={tmp_path / 'file/s.zarr'}")
    assert ended.code == 1 and "cannot be written" in ended.text and "Traceback" not in ended.text, ended.text


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["samples=0"], "samples is 0"),
        (["dtype=int8"], "dtype is 'int8', expected float32 or float16"),
        (["shard=2/2"], "expected i/n"),
        (["out=null"], "out must be given"),
        (["sampler=random_combinations"], "choose a sampler of poses"),
        (["jobs=0"], "jobs is 0"),
    ],
)
def test_what_cannot_be_meant_is_said_first(tmp_path, run, given, said):
    ended = run("sample", *LITTLE, f"out={tmp_path / 's.zarr'}", *given)
    assert ended.code == 1 and said in " ".join(ended.text.split()), ended.text
    assert not (tmp_path / "s.zarr").exists()


def test_a_sweep_over_shards_fills_one_store(tmp_path, run):
    whole, swept = tmp_path / "whole.zarr", tmp_path / "swept.zarr"
    assert run("sample", *LITTLE, f"out={whole}").code == 0
    sweep = ["-m", "shard=0/2,1/2", f"hydra.sweep.dir={tmp_path / 'sweep'}"]
    ended = run("sample", *sweep, *LITTLE, f"out={swept}")
    assert ended.code == 0 and "finished" in ended.text, ended.text
    assert same(whole, swept)


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("stores") / "poses.zarr"
    fill(plan({**PLAN, "samples": 4000, "chunk": 50, "out": str(out)}))
    return out


@pytest.mark.parametrize("model", ["forward", "inverse", pytest.param("holden", marks=pytest.mark.slow)])
def test_every_model_trains_from_a_store(store, run, model):
    small = [] if model == "inverse" else ["model.optimizer.lr=1e-3"]
    made = run("train", f"model={model}", f"data.store={store}", *small)
    assert made.code == 0, made.text


@pytest.mark.slow
def test_a_run_that_reads_a_store_resumes_to_the_same_weights(store, tmp_path, run):
    longer = ["trainer.max_steps=200", "data.steps_per_epoch=40", "checkpoint.every_n_steps=7", "evaluation.validation_poses=2"]
    longer += [f"data.store={store}"]
    whole = run("train", *longer, folder="whole")
    assert whole.code == 0, whole.text
    broken = tmp_path / "broken"
    kill_after(start_training(broken, *longer), broken, step=7, how=signal.SIGKILL)
    assert 7 < saved_step(broken) < 200
    resumed = run("train", *longer, "resume=true", folder="broken")
    assert resumed.code == 0, resumed.text
    assert same_weights(whole.folder, broken)


def test_training_says_what_is_wrong_with_a_store(store, tmp_path, run):
    ended = run("train", f"data.store={tmp_path / 'none.zarr'}")
    assert ended.code == 1 and "there is no store of poses" in ended.text
    ended = run("train", f"data.store={store}", "sampler=random_combinations")
    assert ended.code == 1 and "choose sampler=rig_poses" in " ".join(ended.text.split())
    half = tmp_path / "half.zarr"
    assert run("sample", *LITTLE, f"out={half}", "shard=0/2").code == 0
    ended = run("train", f"data.store={half}")
    assert ended.code == 1 and "not finished" in ended.text
    hurt = Path(shutil.copytree(store, tmp_path / "hurt.zarr"))
    for chunk in range(80):
        flip(hurt / f"coefficients/c/{chunk}/0")
    ended = run("train", f"data.store={hurt}", folder="hurt")
    assert ended.code == 1 and "of 'coefficients' is damaged" in ended.text and "Traceback" not in ended.text, ended.text


def test_a_black_box_is_trained_from_its_store_alone(tmp_path, run):
    out = tmp_path / "b.zarr"
    few = ["mesh_space.samples=40"]
    assert run("sample", CONFIGS, "rig=black_box", "samples=500", "chunk=50", *few, f"out={out}").code == 0
    assert "basis" in zarr.open_group(out, mode="r")
    made = run("train", "rig=black_box", f"data.store={out}", "mesh_space.samples=1")
    assert made.code == 0 and made.metrics["true_rig"] == "black box", made.text
