"""A rig with some controls fixed."""

from torch import Tensor

from riginv.rig.interface import LinearRig, Vjp
from riginv.rig.jacobian import Jacobian


class FixedControlsRig(LinearRig):
    """A rig whose controls are the free controls of another rig.

    Args:
        rig: the other rig.
        free: indices of the free controls, `(free control,)`.
        values: of all controls, `(control,)`; those of free controls are ignored.
    """

    free: Tensor
    values: Tensor

    def __init__(self, rig: LinearRig, free: Tensor, values: Tensor) -> None:
        controls = [rig.controls[number] for number in free.tolist()]
        super().__init__(rig.name, controls, rig.rest_vertices, rig.faces, rig.basis, rig.coefficient_names, rig.primary_count)
        self.rig, self.differentiable = rig, rig.differentiable
        self.length_scale, self.has_first_guess = rig.length_scale, rig.has_first_guess
        self.gradient_steps = rig.gradient_steps
        self.register_buffer("free", free, persistent=False)
        self.register_buffer("values", values.to(rig.dtype), persistent=False)

    def all_controls(self, free: Tensor) -> Tensor:
        """All controls `(batch, control)` for free controls `(batch, free control)`."""
        return self.values.to(free).expand(len(free), -1).index_copy(1, self.free, free)

    def coefficients(self, controls: Tensor) -> Tensor:
        return self.rig.coefficients(self.all_controls(controls))

    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        found, jacobian = self.rig.coefficient_jacobian(self.all_controls(controls))
        return found, jacobian.of_controls(self.free)

    def coefficients_and_vjp(self, controls: Tensor) -> tuple[Tensor, Vjp]:
        found, vjp = self.rig.coefficients_and_vjp(self.all_controls(controls))
        return found, lambda gradient: vjp(gradient).index_select(1, self.free)

    def neutral_coefficients(self) -> Tensor:
        """The coefficients of the rest mesh, for any fixed values."""
        return self.rig.neutral_coefficients()

    def features(self, coefficients: Tensor) -> Tensor | None:
        return self.rig.features(coefficients)

    def feature_change(self, before: Tensor, after: Tensor) -> Tensor:
        return self.rig.feature_change(before, after)

    def guess_from_features(self, features: Tensor) -> Tensor | None:
        guess = self.rig.guess_from_features(features)
        return None if guess is None else guess[:, self.free]

    def continuous(self, controls: Tensor) -> Tensor:
        return self.rig.continuous(self.all_controls(controls))[:, self.free]
