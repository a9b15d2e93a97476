"""The base class of networks, and two ways of making their training faster: bfloat16 and compilation.

Both apply to what is learned, not to the rig or the losses: in bfloat16 a rig's rounding errors exceed those of a good network
(docs/devices.md).
"""

import functools
from collections.abc import Callable

import torch
from torch import Tensor, nn

from riginv.errors import InputError

RIG_PREFIXES = ("rig.", "leading.")


class RigNetwork(nn.Module):
    """A network; it may hold a rig as its attributes `rig` and `leading`, whose weights are not saved with it."""

    def learned_parts(self) -> list[nn.Module]:
        """The submodules that hold its weights and contain no rig."""
        return [self]

    def own_weights(self) -> dict[str, Tensor]:
        """The network's weights and scales, without those of its rig."""
        return {name: value for name, value in self.state_dict().items() if not name.startswith(RIG_PREFIXES)}

    def load_own_weights(self, weights: dict[str, Tensor]) -> None:
        """Load the result of `own_weights`.

        Raises:
            InputError: the weights are not those of such a network.
        """
        expected = self.own_weights()
        if {name: value.shape for name, value in weights.items()} != {name: value.shape for name, value in expected.items()}:
            raise InputError("the weights do not fit the network that the bundle describes; train it again")
        self.load_state_dict(weights, strict=False)


def use_bfloat16(network: RigNetwork) -> None:
    """Evaluate a network's own modules in bfloat16; weights, inputs and outputs keep their types."""
    for part in network.learned_parts():
        part.forward = _in_bfloat16(part.forward)


def compile_parts(network: RigNetwork, device: torch.device) -> None:
    """Compile a network's own modules in place; the names of weights stay.

    Raises:
        InputError: nothing can be compiled here.
    """
    try:
        torch.compile(torch.sin)(torch.zeros(8, device=device))
    except Exception as error:  # of many types: a compiler that is missing, too old, or without headers
        raise InputError(f"trainer.compile=true cannot be used here: {str(error).splitlines()[0]}") from None
    for part in network.learned_parts():
        part.compile()


def _in_bfloat16(forward: Callable[..., Tensor]) -> Callable[..., Tensor]:
    @functools.wraps(forward)
    def computed(*inputs: Tensor) -> Tensor:
        with torch.autocast(inputs[0].device.type, torch.bfloat16):
            return forward(*inputs).to(inputs[0].dtype)

    return computed
