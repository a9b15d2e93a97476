"""What a training step needs where several processes share a batch."""

import torch
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from riginv.errors import InputError


def share_a_batch() -> bool:
    """Whether several processes train together."""
    return torch.distributed.is_available() and torch.distributed.is_initialized()


def part() -> None:
    """Let each process go its own way after training: the others end while the first one judges."""
    if share_a_batch():
        torch.distributed.destroy_process_group()


def over_processes(means: Tensor, count: int) -> tuple[Tensor, float]:
    """Means over the meshes of all processes, from those over the `count` meshes of this one.

    Returns:
        The means, and what this process's loss has to be multiplied by: gradients are averaged over the processes, whatever
        their shares of the batch, so that a larger share must count for more.
    """
    sums = torch.cat([means.double() * count, means.new_tensor([count], dtype=torch.float64)])
    torch.distributed.all_reduce(sums)
    total = sums[-1]
    return (sums[:-1] / total).to(means.dtype), float(count * torch.distributed.get_world_size() / total)


def check_normalisation(network: nn.Module, device: torch.device) -> None:
    """Raises InputError where a network normalises over batches that processes on CPUs would each see a part of."""
    if device.type == "cpu" and any(isinstance(part, _BatchNorm) for part in network.modules()):
        raise InputError(
            "the network normalises over a batch, which several processes on CPUs cannot share: use trainer.devices=1"
        )
