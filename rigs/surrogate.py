"""Trained forward models as differentiable rigs."""

from torch import Tensor

from riginv.config.building import OURS, build
from riginv.inference.bundle import read_bundle
from riginv.networks.base import RigNetwork
from riginv.rig.interface import LinearRig, RigBackend


class SurrogateRig(LinearRig):
    """The surrogate of a bundle that `model=forward` wrote.

    Args:
        bundle: the bundle's folder.

    Attributes:
        true_rig_config: config of the rig that it was trained on, the true rig of what is trained through it.

    Raises:
        InputError: the bundle is missing, damaged, or not a surrogate's.
    """

    is_surrogate = True

    def __init__(self, bundle: str) -> None:
        read = read_bundle(bundle, kind="forward")
        facts = read.description["rig"]
        frame, linear_map = read.space["frame"], read.space["linear_map"]
        basis = (linear_map @ frame.flatten(1)).unflatten(1, frame.shape[1:])
        super().__init__(
            f"surrogate of {facts['name']}",
            read.controls,
            read.space["rest_vertices"],
            read.space["faces"],
            basis,
            facts["coefficient_names"],
            facts["primary_count"],
        )
        self.true_rig_config: dict = facts["config"]
        self.network = build(read.description["network"], self, kind=RigNetwork, only=OURS)
        self.network.load_own_weights(read.weights)
        self.requires_grad_(False)

    def true_rig(self) -> RigBackend:
        return build(self.true_rig_config, kind=RigBackend, only=OURS)

    def coefficients(self, controls: Tensor) -> Tensor:
        return self.network(controls.to(self.dtype)).to(controls.dtype)  # a network computes in the dtype of its weights
