"""Threads: as many as other processes leave cores for, and none of it shows in any result."""

import os
import subprocess
import sys
import threading
import time

import pytest
import torch

from riginv.networks.ablations import NormalisedInverse
from riginv.networks.inverse import DirectInverse, StagedInverse
from riginv.rig.batches import PoseBatch, generator_at
from riginv.runs.threads import Workers, single_threaded, workers
from riginv.sampling.controls import PlausibleControls
from riginv.sampling.meshes import RigPoses
from riginv.training.data import PoseDataModule, bare_trainer
from riginv.training.inverse import InverseModule
from riginv.training.losses import RmsVertexDistanceLoss
from riginv.training.parallel import can_be_halved, worth_splitting
from tests.training.test_modules import ADAM, CONSTANT, Cubes


@pytest.fixture
def unlimited(monkeypatch):
    for name in ("OMP_NUM_THREADS", "RIGINV_THREADS"):
        monkeypatch.delenv(name, raising=False)


def test_beside_busy_processes_one_thread_is_chosen(unlimited):
    workers = Workers(most=2)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(max(1, workers.cores.count - 1))]
    try:
        workers.cores.free()
        time.sleep(1.0)
        assert workers.update_count() == 1
        assert workers.describe().startswith("1 thread of ")
    finally:
        for process in busy:
            process.kill()
            process.wait()


def test_its_own_threads_do_not_count_as_others(unlimited):
    workers, stop = Workers(), threading.Event()

    def work() -> None:
        values = torch.rand(300, 300)
        while not stop.is_set():
            values = (values @ values).softmax(dim=1)

    thread = threading.Thread(target=work)
    workers.cores.free()
    began = os.times()
    thread.start()
    time.sleep(1.0)
    stop.set()
    thread.join()
    ended = os.times()
    own = (ended.user + ended.system - began.user - began.system) / (ended.elapsed - began.elapsed)
    assert workers.cores.free() >= own - 0.2


def test_the_number_can_be_asked_for(unlimited, monkeypatch):
    assert Workers(2).update_count() == 2 and Workers(2).describe() == "2 threads, as configured"
    assert Workers(3, most=2).update_count() == 2
    monkeypatch.setenv("RIGINV_THREADS", "2")
    assert Workers().update_count() == 2
    monkeypatch.delenv("RIGINV_THREADS")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setattr(time, "sleep", lambda seconds: pytest.fail("free cores were counted"))
    assert Workers().update_count() == 1 and "counted" not in Workers().describe()


def test_what_others_do_is_known_without_waiting(unlimited, monkeypatch):
    monkeypatch.setattr(time, "sleep", lambda seconds: pytest.fail("the first look waits"))
    found = workers.__wrapped__()
    assert 1 <= found.update_count() <= found.cores.count and found.counts_cores == (found.cores.count > 1)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_results_come_in_order_and_run_at_once(threads):
    workers, seen = Workers(threads), set()

    def task(number: int) -> int:
        seen.add(threading.get_ident())
        time.sleep(0.05)
        assert torch.get_num_threads() == 1
        return workers.run([lambda: number, lambda: number**2])[1]  # within a task there are no further threads

    assert workers.run([lambda number=number: task(number) for number in range(7)]) == [number**2 for number in range(7)]
    assert len(seen) == threads


def test_gradients_are_on_or_off_as_where_the_work_is_asked_for():
    workers = Workers(2)

    def tasks() -> list[bool]:
        return workers.run([lambda: time.sleep(0.02) or torch.is_grad_enabled() for _ in range(4)])

    assert tasks() == [True] * 4
    with torch.no_grad():
        assert tasks() == [False] * 4


@pytest.mark.parametrize("failing", [0, 1])
def test_what_fails_in_a_thread_fails_here(failing):
    def task(number: int) -> int:
        if number == failing:
            raise ValueError(f"task {number}")
        return number

    with pytest.raises(ValueError, match=f"task {failing}"):
        Workers(2).run([lambda number=number: task(number) for number in range(2)])


def test_a_single_thread_for_a_while():
    before = torch.get_num_threads()
    with single_threaded():
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before


def one_step(toy, workers, kind, rows=40):
    torch.manual_seed(0)
    network = kind(toy, hidden=[512, 512])
    module = InverseModule(toy, network, RmsVertexDistanceLoss(162), ADAM, CONSTANT, sampled_vertices=40)
    module.workers, module.log = workers, lambda *args, **kwargs: None
    batch = RigPoses(toy, PlausibleControls(toy)).sample(rows, generator_at(0, "step"))
    network.calibrate(batch["coordinates"])
    loss = module.training_step(batch, 0)
    (0.5 * loss).backward()
    return loss.detach(), [weight.grad for weight in network.parameters() if weight.grad is not None]


@pytest.mark.parametrize("kind", [StagedInverse, DirectInverse])  # stages side by side, halves of the batch
def test_threads_give_the_gradients_of_one_and_the_same_bits(kind, toy, monkeypatch):
    monkeypatch.setattr("riginv.training.parallel.WORTH_SPLITTING", 1)
    (whole, expected), (one, by_one), (two, by_two) = (one_step(toy, given, kind) for given in (None, Workers(1), Workers(2)))
    assert torch.equal(one, two) and all(torch.equal(a, b) for a, b in zip(by_one, by_two)) and len(by_one) == len(expected)
    torch.testing.assert_close(one, whole)
    for found, wanted in zip(by_one, expected):
        torch.testing.assert_close(found, wanted, rtol=1e-3, atol=1e-5 * float(wanted.abs().max()) + 1e-7)


def test_all_of_a_step_runs_on_one_thread_where_workers_share_it(toy):
    numbers: list[int] = []
    before = torch.get_num_threads()

    class Recording(torch.optim.Adam):
        def step(self, closure=None):
            loss = super().step(closure)
            numbers.append(torch.get_num_threads())
            return loss

    def trained(workers: Workers | None) -> list[int]:
        numbers.clear()
        module = InverseModule(toy, StagedInverse(toy, hidden=[8]), RmsVertexDistanceLoss(162), Recording, CONSTANT)
        module.workers = workers
        module.train()
        data = PoseDataModule(RigPoses(toy, PlausibleControls(toy)), {}, 4, 2, seed=0)
        bare_trainer(accelerator="cpu", max_steps=2).fit(module, data)
        return list(numbers)

    try:
        torch.set_num_threads(3)
        assert trained(Workers(1)) == [1, 1] and trained(None) == [3, 3]
    finally:
        torch.set_num_threads(before)


def test_the_next_batch_is_drawn_ahead_once_and_is_the_same(toy, monkeypatch):
    monkeypatch.setattr("riginv.training.parallel.WORTH_SPLITTING", 1)
    drawn = []

    class Recorded(RigPoses):
        def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
            batch = super().sample(count, generator)
            drawn.append(batch["coordinates"])
            return batch

    def trained(workers: Workers | None) -> list[torch.Tensor]:
        torch.manual_seed(0)
        drawn.clear()
        module = InverseModule(toy, StagedInverse(toy, hidden=[64]), RmsVertexDistanceLoss(162), ADAM, CONSTANT)
        module.workers = workers
        module.train()  # the rig, which tests share
        data = PoseDataModule(Recorded(toy, PlausibleControls(toy)), {}, 16, 3, seed=0)  # an epoch ends in between
        bare_trainer(accelerator="cpu", max_steps=5).fit(module, data)
        return list(drawn)

    alone, ahead = trained(None), trained(Workers(2))
    assert len(alone) == len(ahead) == 5 and all(torch.equal(one, other) for one, other in zip(alone, ahead))


def test_what_is_not_a_mean_over_meshes_is_computed_whole(toy):
    staged = StagedInverse(toy, hidden=[8])
    assert can_be_halved(staged, [RmsVertexDistanceLoss(162)]) and not can_be_halved(staged, [Cubes()])
    assert not can_be_halved(NormalisedInverse(toy, "batch", [8]), [])
    weights = list(staged.parameters())
    assert not worth_splitting(2, weights) and not worth_splitting(1, weights) and worth_splitting(10_000_000, weights)
