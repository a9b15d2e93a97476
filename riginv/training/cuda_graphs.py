"""Training steps and draws on a GPU as CUDA graphs: their hundreds of small operations are launched at once."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar, cast

import torch
from torch import Tensor, nn

from riginv.rig.batches import PoseBatch, map_batches
from riginv.training.parallel import LossAndCoordinates, with_gradients

WARM_UP = 3  # calls before the capture, as PyTorch advises: libraries choose their algorithms in them
TOLERANCE = 1e-3  # relative difference between what a graph and PyTorch compute
Draw = Callable[[torch.Generator], PoseBatch]
Found = TypeVar("Found")


class NotCapturedError(RuntimeError):
    """A graph computes something else than what was captured, such as what depends on values outside the GPU."""


class _Loss(NamedTuple):
    loss: Tensor
    coordinates: Tensor
    gradients: list[Tensor | None]


class GraphedStep:
    """Loss, predicted coordinates and gradients of a batch, captured once and replayed for batches of the same shapes.

    Args:
        compute: returns the mean loss of a batch, with a graph, and the predicted coordinates `(batch, coordinate)`, detached.
        batch: the first batch.
        weights: the parameters to differentiate by, on a GPU.

    Raises:
        RuntimeError: the step cannot be captured, as one that waits for the GPU.
    """

    def __init__(self, compute: LossAndCoordinates, batch: PoseBatch, weights: Sequence[nn.Parameter]) -> None:
        self.compute, self.weights = compute, weights
        self.batch = map_batches(torch.clone, batch)
        self.graph = torch.cuda.CUDAGraph()
        self.found = _captured(self.graph, self._compute)
        self.calls = 0

    def fits(self, batch: PoseBatch) -> bool:
        """Whether a batch has the shapes of the first one."""
        return _shapes(batch) == _shapes(self.batch)

    def __call__(self, batch: PoseBatch) -> tuple[Tensor, Tensor]:
        """The loss of a batch, which carries the gradients of the weights, and the coordinates.

        Raises:
            NotCapturedError: the loss of the second batch, after one step of the optimiser, is not what PyTorch computes.
        """
        map_batches(Tensor.copy_, self.batch, batch)
        self.graph.replay()
        self.calls += 1
        if self.calls == 2 and not torch.allclose(self.compute(batch)[0], self.found.loss, rtol=TOLERANCE):
            raise NotCapturedError("a replayed step has another loss")
        return with_gradients(self.found.loss, self.found.gradients, self.weights), self.found.coordinates

    def _compute(self) -> _Loss:
        loss, coordinates = self.compute(self.batch)
        gradients = torch.autograd.grad(loss, self.weights, allow_unused=True)
        return _Loss(loss.detach(), coordinates, list(gradients))


class GraphedDraw:
    """Batches drawn from a seed, captured once and replayed.

    Args:
        draw: from a generator to a batch.
        device: a GPU.

    Raises:
        RuntimeError: it cannot be captured, as what reads stored poses.
        NotCapturedError: what is replayed is not what is drawn.
    """

    def __init__(self, draw: Draw, device: torch.device) -> None:
        self.generator, self.graph = torch.Generator(device), torch.cuda.CUDAGraph()
        self.graph.register_generator_state(self.generator)
        self.found = _captured(self.graph, lambda: draw(self.generator))
        drawn, replayed = draw(torch.Generator(device).manual_seed(WARM_UP)), self(WARM_UP)
        pairs = [(cast(dict, drawn)[key], values) for key, values in cast(dict[str, Tensor], replayed).items()]
        if not all(torch.allclose(*pair, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True) for pair in pairs):
            raise NotCapturedError("a replayed batch has other meshes")

    def __call__(self, seed: int) -> PoseBatch:
        """The batch of a seed."""
        self.generator.manual_seed(seed)
        self.graph.replay()
        return map_batches(torch.clone, self.found)


def _captured(graph: torch.cuda.CUDAGraph, compute: Callable[[], Found]) -> Found:
    """Capture what a function does on the present GPU; its results are those of the latest replay."""
    aside = torch.cuda.Stream()
    aside.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(aside):
        for _ in range(WARM_UP):
            compute()
    torch.cuda.current_stream().wait_stream(aside)
    with torch.cuda.graph(graph):
        return compute()


def _shapes(batch: PoseBatch) -> dict[str, torch.Size]:
    return {key: cast(Tensor, values).shape for key, values in batch.items()}
