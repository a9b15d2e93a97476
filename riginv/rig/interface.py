"""The interface of rigs: named, bounded controls, a rest mesh, and a function from controls to vertices (paper, Eq. 1)."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.geometry.axis_basis import AxisBasisCache
from riginv.geometry.blendshapes import apply_deltas
from riginv.geometry.kernels.library import pure_torch
from riginv.geometry.kinematics import Skeleton
from riginv.rig.arkit import ArkitParts
from riginv.rig.checks import check_controls, check_mesh
from riginv.rig.jacobian import Jacobian, finite_differences

if TYPE_CHECKING:
    from riginv.rig.batches import PoseBatch
    from riginv.rig.mesh_sets import MeshSet
    from riginv.rig.mesh_space import MeshSpace

Vjp = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Control:
    """One control of a rig, a value that animators set.

    Attributes:
        name: unique within the rig.
        lower: the least value.
        upper: the greatest value.
        neutral: the value at rest.
        unit: of the value: `deg`, `mm`, or empty for a plain weight.
    """

    name: str
    lower: float = 0.0
    upper: float = 1.0
    neutral: float = 0.0
    unit: str = ""


@dataclass(frozen=True)
class Motion:
    """A motion of a rig's own to evaluate inverses on.

    Attributes:
        name: its key in metrics.
        fps: frames a second.
        vertices: `(frame, vertex, 3)`, mm; in reach of the rig's controls or not.
    """

    name: str
    fps: float
    vertices: Tensor


class RigBackend(nn.Module, ABC):
    """A rig: `forward` maps controls to vertices. It has no trained weights, and does not clamp controls to their limits.

    Attributes:
        name: what tables call it.
        controls: the controls, in the order of the last dimension of a control tensor.
        lower, upper, neutral_controls: `(control,)`.
        rest_vertices: `(vertex, 3)`, mm.
        faces: `(face, 3)` indices of vertices.
        differentiable: whether gradients pass from the vertices to the controls.
        notes: sentences for the user about what was repaired or guessed when the rig was read.
        contents: a short description such as `52 primary shapes, 12 in-betweens`; may be empty.
        poses_subsets: whether `vertex_subset` is implemented: some vertices can be posed for less than all of them.
        mesh_file: the file of the rest mesh, whose polygons meshes for users have; None: there is none.
        unit_mm: millimetres per unit of the rig's files.
        held_out: the evaluation poses of a rig that is known by recorded poses alone; None: the rig can be posed.

    Raises:
        InputError: the controls, the mesh or the faces do not make a rig.
    """

    differentiable: bool = True
    notes: tuple[str, ...] = ()
    contents: str = ""
    poses_subsets: bool = False
    mesh_file: Path | None = None
    unit_mm: float = 1.0
    held_out: "MeshSet | None" = None
    lower: Tensor
    upper: Tensor
    neutral_controls: Tensor
    rest_vertices: Tensor
    faces: Tensor

    def __init__(self, name: str, controls: Sequence[Control], rest_vertices: Tensor, faces: Tensor) -> None:
        super().__init__()
        self.name = name
        self.controls = tuple(controls)
        check_controls(name, self.controls)
        check_mesh(name, rest_vertices, faces)
        for field in ("lower", "upper", "neutral"):
            values = torch.tensor([getattr(control, field) for control in self.controls], dtype=rest_vertices.dtype)
            self.register_buffer("neutral_controls" if field == "neutral" else field, values, persistent=False)
        self.register_buffer("rest_vertices", rest_vertices, persistent=False)
        self.register_buffer("faces", faces.long(), persistent=False)

    @property
    def control_names(self) -> tuple[str, ...]:
        return tuple(control.name for control in self.controls)

    @property
    def dtype(self) -> torch.dtype:
        return self.rest_vertices.dtype

    @property
    def device(self) -> torch.device:
        return self.rest_vertices.device

    def arkit_deltas(self) -> dict[str, Tensor]:
        """The deltas `(vertex, 3)`, mm, of the ARKit shapes that the rig has, by name; empty where it has none.

        They turn a Live Link Face recording into a mesh clip.
        """
        return {}

    def arkit_parts(self) -> dict[str, ArkitParts]:
        """The rig's shapes that correspond to each of the ARKit shapes in `arkit_deltas`, for messages."""
        return {}

    def expressions(self) -> dict[str, dict[str, float]]:
        """Named example poses: the controls that are not neutral, by name; may be empty."""
        return {}

    def motion(self) -> Motion | None:
        """A motion to evaluate inverses on without a capture; None: a simulated performance, where the rig has blendshapes."""
        return None

    def skeleton(self) -> Skeleton | None:
        """The joints of a rig that is only skinned, for export to BVH, glTF and USD; None for other rigs."""
        return None

    def vertex_colors(self) -> Float[Tensor, "vertex 3"] | None:
        """Colours `(vertex, 3)` in [0, 1] for pictures, or None for plain clay."""
        return None

    def true_rig(self) -> "RigBackend":
        """The rig that evaluates models trained on this one: itself, or the rig that it approximates."""
        return self

    def vertex_subset(self, rows: Int[Tensor, " row"]) -> nn.Module:
        """A module from controls `(batch, control)` to the vertices `rows` alone, `(batch, row, 3)`, mm; see `poses_subsets`.

        Large black-box rigs are posed at these alone in training (`riginv.rig.black_box`).
        """
        raise NotImplementedError(f"rig '{self.name}' poses all of its vertices at once")

    @abstractmethod
    def forward(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch vertex 3"]:
        """Controls `(batch, control)` to vertices `(batch, vertex, 3)`, mm (the paper's L, Eq. 1)."""


class LinearRig(RigBackend):
    """A rig that ends in a linear map: vertices = rest + (f(controls) - f(neutral)) basis.

    In blendshape rigs f gives the weights of the shapes, in linear blend skinning the entries of the skinning matrices. Mesh
    space is built on this form (`riginv.rig.mesh_space`).

    Attributes:
        basis: `(coefficient, vertex, 3)`, mm per unit of each coefficient.
        coefficient_names: one for each coefficient.
        primary_count: of a blendshape rig, whose coefficients are weights in [0, 1], 0 at rest: the number of primary shapes,
            which controls drive directly; the correctives (in-betweens, combinations) follow them. 0 for other rigs.
        joint_noise: `(part,)`: standard deviations of rotations that joints may have beside those that controls give them, as
            in captures; `coefficients_with_joint_noise` applies them. Empty where a rig has none.
        is_fitted: whether the basis was fitted to sampled poses: its coefficients are scaled by their spread and have no names.
        is_surrogate: whether it is a learned surrogate of another rig, its `true_rig()`.
        has_first_guess: whether `guess_from_features` is near the solution, so that solvers need no other start.
        gradient_steps: steps that solvers take with a new gradient alone after each Jacobian, for rigs whose Jacobian costs
            much more than a gradient.
        length_scale: factor on the lengths in mm that solvers take for small, for rigs whose files may be in any unit.
    """

    is_fitted: bool = False
    is_surrogate: bool = False
    gradient_steps: int = 0
    length_scale: float = 1.0
    has_first_guess: bool = False
    basis: Tensor
    joint_noise: Tensor

    def __init__(
        self,
        name: str,
        controls: Sequence[Control],
        rest_vertices: Tensor,
        faces: Tensor,
        basis: Tensor,
        coefficient_names: Sequence[str] | None = None,
        primary_count: int = 0,
    ) -> None:
        super().__init__(name, controls, rest_vertices, faces)
        if basis.shape[1:] != rest_vertices.shape:
            raise InputError(
                f"rig '{name}': the basis has shape {tuple(basis.shape)}, expected (coefficient, *{tuple(rest_vertices.shape)})"
            )
        self.register_buffer("basis", basis, persistent=False)
        self.register_buffer("joint_noise", rest_vertices.new_zeros(0), persistent=False)
        self.coefficient_names = tuple(coefficient_names or (f"coefficient_{i}" for i in range(len(basis))))
        self.primary_count = primary_count
        self._by_axis = AxisBasisCache()

    @property
    def has_blendshapes(self) -> bool:
        return self.primary_count > 0

    @abstractmethod
    def coefficients(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch coefficient"]:
        """Controls `(batch, control)` to coefficients `(batch, coefficient)`: the nonlinear part f of the rig."""

    def coefficient_jacobian(
        self, controls: Float[Tensor, "batch control"]
    ) -> tuple[Float[Tensor, "batch coefficient"], Jacobian]:
        """The coefficients `(batch, coefficient)` of controls `(batch, control)`, and their Jacobian.

        By automatic differentiation, or by finite differences for a rig that is not differentiable. Rigs may override it with
        their analytic derivative.
        """
        if not self.differentiable:
            return finite_differences(self.coefficients, controls, self.lower, self.upper)
        with torch.enable_grad(), pure_torch():  # kernels do not support batched gradients
            given = controls.detach().requires_grad_()
            found = self.coefficients(given)
            rows = torch.eye(found.shape[1]).to(found)[:, None].expand(-1, len(controls), -1)
            derivatives = torch.autograd.grad(found, given, rows, is_grads_batched=True)[0]
        return found.detach(), Jacobian(inner=derivatives.transpose(0, 1))

    def coefficients_and_vjp(self, controls: Float[Tensor, "batch control"]) -> tuple[Float[Tensor, "batch coefficient"], Vjp]:
        """The coefficients `(batch, coefficient)` of controls `(batch, control)`, and their vector-Jacobian product.

        The latter maps a gradient by the coefficients, `(batch, coefficient)`, to one by the controls, `(batch, control)`.
        Neither has a graph. As in `coefficient_jacobian`, rigs may override it.
        """
        if not self.differentiable:
            found, jacobian = self.coefficient_jacobian(controls)
            return found, jacobian.vjp
        with torch.enable_grad():
            given = controls.detach().requires_grad_()
            found = self.coefficients(given)
        return found.detach(), lambda gradient: torch.autograd.grad(found, given, gradient, retain_graph=True)[0]

    def neutral_coefficients(self) -> Float[Tensor, "1 coefficient"]:
        """The coefficients `(1, coefficient)` of the rest mesh."""
        return self.coefficients(self.neutral_controls[None])

    def posing_rig(self) -> RigBackend:
        """The rig that is posed for meshes: itself, or the one that the basis was fitted to."""
        return self

    def poses_to_train_on(self, space: "MeshSpace") -> "PoseBatch | None":
        """The recorded poses to train on, in mesh coordinates; None for a rig that can be posed."""
        return None

    def features(self, coefficients: Float[Tensor, "batch coefficient"]) -> Float[Tensor, "batch feature"] | None:
        """Inputs for an inverse network in place of mesh coordinates: `(batch, feature)`, differentiable.

        From coefficients `(batch, coefficient)`; None where mesh coordinates serve. A skinned rig gives the rotation of each
        joint relative to its parent.
        """
        return None

    def feature_change(
        self, before: Float[Tensor, "#batch feature"], after: Float[Tensor, "batch feature"]
    ) -> Float[Tensor, "batch feature"]:
        """The difference of features `(batch, feature)`; a rig with angles among them takes the shorter way round."""
        return after - before

    def guess_from_features(self, features: Float[Tensor, "batch feature"]) -> Float[Tensor, "batch control"] | None:
        """Controls `(batch, control)` near those that make features; None: `riginv.networks.features` fits a linear map."""
        return None

    def continuous(self, controls: Float[Tensor, "frame control"]) -> Float[Tensor, "frame control"]:
        """Controls `(frame, control)` of the same meshes that change least from frame to frame: angles without jumps."""
        return controls

    def coefficients_with_joint_noise(
        self, controls: Float[Tensor, "batch control"], parts: Float[Tensor, "batch part"]
    ) -> Float[Tensor, "batch coefficient"]:
        """The coefficients `(batch, coefficient)` of poses whose joints are rotated by noise `parts` `(batch, part)`, too."""
        return self.coefficients(controls)

    def forward(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch vertex 3"]:
        change = self.coefficients(controls) - self.neutral_coefficients().to(controls)
        if (by_axis := self._by_axis.get(self.basis, change)) is not None:
            return self.rest_vertices + by_axis.displacements(change)
        return apply_deltas(self.rest_vertices.to(controls), self.basis.to(controls), change)
