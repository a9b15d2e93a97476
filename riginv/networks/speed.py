"""Two ways of making training faster that leave the rig and the losses as they are: bfloat16, and compiled code.

Both touch what learns and nothing else. A rig in bfloat16 is off by more than a good network is (docs/devices.md).
"""

import functools
from collections.abc import Callable

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.networks.base import RigNetwork


def use_bfloat16(network: RigNetwork) -> None:
    """Compute what a network learned in bfloat16; its weights, its inputs and its answers stay as they are."""
    for part in network.learned_parts():
        part.forward = _in_bfloat16(part.forward)


def compile_parts(network: RigNetwork, device: torch.device) -> None:
    """Compile what a network learned, in place: the names of its weights stay.

    Raises:
        InputError: nothing can be compiled here.
    """
    try:
        torch.compile(torch.sin)(torch.zeros(8, device=device))
    except Exception as error:  # of many kinds: a compiler that is missing, too old, or without headers
        raise InputError(f"trainer.compile=true cannot be used here: {str(error).splitlines()[0]}") from None
    for part in network.learned_parts():
        part.compile()


def _in_bfloat16(forward: Callable[..., Tensor]) -> Callable[..., Tensor]:
    @functools.wraps(forward)
    def computed(*inputs: Tensor) -> Tensor:
        with torch.autocast(inputs[0].device.type, torch.bfloat16):
            return forward(*inputs).to(inputs[0].dtype)

    return computed
