"""What all networks of riginv share: weights that are their own, apart from those of a rig that they look through."""

from torch import Tensor, nn

from riginv.errors import InputError

RIG_PREFIX = "rig."


class RigNetwork(nn.Module):
    """A network that may hold a rig as its attribute `rig`, whose weights are not its own."""

    def learned_parts(self) -> list[nn.Module]:
        """The modules within it that hold its weights and are called as they are, with no rig inside."""
        return [self]

    def own_weights(self) -> dict[str, Tensor]:
        """The network's weights and scales, without those that its rig may have."""
        return {name: value for name, value in self.state_dict().items() if not name.startswith(RIG_PREFIX)}

    def load_own_weights(self, weights: dict[str, Tensor]) -> None:
        """Load what `own_weights` gave.

        Raises:
            InputError: the weights are not those of such a network.
        """
        expected = self.own_weights()
        if {name: value.shape for name, value in weights.items()} != {name: value.shape for name, value in expected.items()}:
            raise InputError("the weights do not fit the network that the bundle describes; train it again")
        self.load_state_dict(weights, strict=False)
