"""A training step on two threads: the backward pass of each stage beside the forward pass of the next, or halves of the batch.

Results have the same bits whatever the number of threads.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import chain
from queue import SimpleQueue
from threading import Lock
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from riginv.networks.correction import Estimate
from riginv.rig.batches import PoseBatch, split_batch
from riginv.runs.threads import Workers

HALVES = 2
WORTH_SPLITTING = 1 << 24  # multiplications of a batch with all weights: below it a second thread has nothing to gain
LossAndCoordinates = Callable[[PoseBatch], tuple[Tensor, Tensor]]


def can_be_halved(network: nn.Module, losses: Sequence[nn.Module]) -> bool:
    """Whether halves of a batch can be computed separately: no layer normalises over it, and losses are means over meshes."""
    normalised = any(isinstance(part, _BatchNorm) for part in network.modules())
    return not normalised and all(getattr(loss, "mean_of_meshes", False) for loss in losses)


def worth_splitting(rows: int, weights: Sequence[nn.Parameter]) -> bool:
    """Whether a batch is on a CPU and large enough for two threads."""
    return rows >= HALVES and weights[0].device.type == "cpu" and rows * sum(w.numel() for w in weights) >= WORTH_SPLITTING


def half_sizes(batch: PoseBatch) -> list[int]:
    """The numbers of meshes of both halves of a batch."""
    count = len(batch["coordinates"])
    return [count - count // HALVES, count // HALVES]


def in_stages(
    estimates: Iterable[Estimate],
    parts: Sequence[nn.Module],
    backward: Callable[[Estimate, int, PoseBatch], tuple[Tensor, Tensor]],
    batch: PoseBatch,
    workers: Workers,
    meanwhile: Callable[[], None],
) -> tuple[Tensor, Tensor]:
    """The loss of a batch, with the gradients of all weights, and the coordinates of the last estimate.

    No gradient passes from a stage to the one before it, so one thread computes the estimates and another the gradients of each
    stage as soon as its estimate is there. Nothing follows the last estimate, so each thread takes half of its meshes.

    Args:
        estimates: of all stages, computed as they are iterated over.
        parts: the stages' modules.
        backward: from an estimate, its index and its meshes to its mean loss and the gradient of that by its raw outputs, both
            without a graph.
        batch: at least two meshes.
        workers: threads.
        meanwhile: called by the second thread, which has nothing to do until the first estimate is there.
    """
    waiting: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
    values: list[Tensor] = [torch.empty(0)] * len(parts)
    gradients: list[tuple[Tensor, ...]] = [()] * len(parts)
    weights = [[weight for weight in part.parameters() if weight.requires_grad] for part in parts]
    coordinates: list[Tensor] = []

    def differentiate(number: int, estimate: Estimate) -> None:
        values[number], gradient = backward(estimate, number, batch)
        gradients[number] = torch.autograd.grad(estimate.raw, weights[number], gradient)

    def differentiate_last(last: Estimate) -> None:
        number, halves = len(parts) - 1, split_batch(batch, sizes := half_sizes(batch))
        found: list[tuple[Tensor, Tensor, Tensor] | None] = [None, None]
        lock = Lock()

        def differentiate_half(half: int, estimate: Estimate) -> None:
            value, gradient = backward(estimate, number, halves[half])
            fraction = sizes[half] / sum(sizes)
            with lock:
                found[half] = fraction * value, fraction * gradient, estimate.detached_coordinates
                if None in found:
                    return
            of_halves, by_raw, meshes = zip(*filter(None, found))
            values[number] = sum(of_halves[1:], of_halves[0])
            gradients[number] = torch.autograd.grad(last.raw, weights[number], torch.cat(by_raw))
            coordinates.append(torch.cat(meshes))

        for half, estimate in enumerate(last.split(sizes)):
            waiting.put(partial(differentiate_half, half, estimate))

    def work() -> None:
        while (task := waiting.get()) is not None:
            task()
        waiting.put(None)  # for the other thread

    def estimate_all() -> None:
        try:
            for number, estimate in enumerate(estimates):
                if number + 1 == len(parts):
                    differentiate_last(estimate)
                    break
                _ = estimate.gradient  # the next stage needs it, too: computed by this thread alone
                waiting.put(partial(differentiate, number, estimate))
        finally:
            waiting.put(None)
        work()

    def follow() -> None:
        meanwhile()
        work()

    workers.run([estimate_all, follow])
    return with_gradients(sum(values[1:], values[0]), list(chain(*gradients)), list(chain(*weights))), coordinates[0]


def in_halves(
    compute: LossAndCoordinates, batch: PoseBatch, weights: Sequence[nn.Parameter], workers: Workers
) -> tuple[Tensor, Tensor]:
    """Loss and predicted coordinates of a batch, from those of its halves; the loss carries the gradients of the weights.

    The halves, and the order of their sum, do not depend on the number of threads: nor does any bit of the result.

    Args:
        compute: returns the mean loss of a batch, with a graph, and the predicted coordinates `(batch, coordinate)`, detached.
        batch: at least two meshes.
        weights: the parameters to differentiate by.
        workers: threads; the result does not depend on their number.
    """
    count, sizes = len(batch["coordinates"]), half_sizes(batch)
    halves = split_batch(batch, sizes)

    def half(part: PoseBatch, fraction: float) -> tuple[Tensor, Tensor, tuple[Tensor | None, ...]]:
        loss, coordinates = compute(part)
        scale = torch.full_like(loss, fraction)
        return fraction * loss.detach(), coordinates, torch.autograd.grad(loss, weights, scale, allow_unused=True)

    tasks = [partial(half, part, size / count) for part, size in zip(halves, sizes)]
    (loss, coordinates, gradients), (second_loss, second_coordinates, second_gradients) = workers.run(tasks)
    pairs = [(first, second) for first, second in zip(gradients, second_gradients) if first is not None and second is not None]

    def add(numbers: list[int]) -> None:
        torch._foreach_add_([pairs[number][0] for number in numbers], [pairs[number][1] for number in numbers])

    runs = _evenly([first.numel() for first, _ in pairs], list(range(len(pairs))))
    workers.run([partial(add, numbers) for numbers in runs])
    total = with_gradients(loss + second_loss, list(gradients), weights)
    return total, torch.cat([coordinates, second_coordinates])


def _evenly(sizes: list[int], numbers: list[int]) -> list[list[int]]:
    """Numbers in `HALVES` runs of about the same total size."""
    runs: list[list[int]] = [[] for _ in range(HALVES)]
    filled, total = 0, max(sum(sizes), 1)
    for number, size in zip(numbers, sizes):
        runs[min(HALVES - 1, HALVES * filled // total)].append(number)
        filled += size
    return [run for run in runs if run]


def with_gradients(loss: Tensor, gradients: list[Tensor | None], tensors: Sequence[Tensor]) -> Tensor:
    """A loss that carries its precomputed gradients by weights or by raw outputs; for one backward pass."""
    return _WithGradients.apply(loss, gradients, *tensors)


class _WithGradients(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, loss: Tensor, gradients: list[Tensor | None], *weights: Tensor) -> Tensor:
        ctx.gradients = gradients
        return loss.clone()

    @staticmethod
    def backward(ctx: Any, scale: Tensor) -> tuple[Tensor | None, ...]:
        gradients, ctx.gradients = ctx.gradients, []  # handed on, not copied: they are as large as the network
        if scale.device.type != "cpu" or float(scale) != 1:  # elsewhere a look at it waits for the device
            gradients = [None if gradient is None else scale * gradient for gradient in gradients]
        return None, None, *gradients
