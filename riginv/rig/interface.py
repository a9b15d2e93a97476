"""What a rig is: named, bounded controls and a rest mesh, and a function from the controls to the vertices (paper, Eq. 1)."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.geometry.blendshapes import apply_deltas
from riginv.geometry.kernels.library import pure_torch
from riginv.geometry.skeleton import Skeleton
from riginv.rig.arkit import ArkitParts
from riginv.rig.checks import check_controls, check_mesh
from riginv.rig.jacobian import Jacobian, finite_differences

if TYPE_CHECKING:
    from riginv.rig.batches import PoseBatch
    from riginv.rig.mesh_sets import MeshSet
    from riginv.rig.mesh_space import MeshSpace

Pull = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Control:
    """One control: what an animator moves.

    Attributes:
        name: unique within the rig.
        lower: the least value.
        upper: the greatest value.
        neutral: the value at rest.
        unit: of the value as animators see it: empty for a plain weight, `deg` or `mm`.
    """

    name: str
    lower: float = 0.0
    upper: float = 1.0
    neutral: float = 0.0
    unit: str = ""


@dataclass(frozen=True)
class Motion:
    """A motion that a rig's author offers to judge inverses on.

    Attributes:
        name: the key of its figures in metrics.
        fps: frames a second.
        vertices: `(frame, vertex, 3)`, mm; in reach of the rig's controls or not.
    """

    name: str
    fps: float
    vertices: Tensor


class RigBackend(nn.Module, ABC):
    """A rig: `forward` maps controls to vertices. It holds facts, nothing that is trained, and never clamps its controls.

    Attributes:
        name: what tables call it.
        controls: the controls, in the order of the last dimension of a control tensor.
        lower, upper, neutral_controls: `(control,)`.
        rest_vertices: `(vertex, 3)`, mm.
        faces: `(face, 3)` indices of vertices.
        differentiable: whether gradients pass from the vertices to the controls.
        notes: whole sentences for the user: what was mended or guessed when the rig was read.
        contents: what it was made from, in a few words: `52 primary shapes, 12 in-betweens`; empty: nothing to say.
        poses_some: whether it makes some of its vertices for less than all of them (`some_vertices`).
        held_out: of a rig that is known by recorded poses alone: those that evaluate in its place; None: it can be posed.

    Raises:
        InputError: the controls, the mesh or the faces do not make a rig.
    """

    differentiable: bool = True
    notes: tuple[str, ...] = ()
    contents: str = ""
    poses_some: bool = False
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

        A Live Link Face recording is made into a mesh clip with them.
        """
        return {}

    def arkit_parts(self) -> dict[str, ArkitParts]:
        """Which of the rig's own shapes stand for each of the ARKit shapes in `arkit_deltas`, so that it can be said."""
        return {}

    def expressions(self) -> dict[str, dict[str, float]]:
        """Named poses worth looking at: the controls that leave neutral, by name; empty where nobody named any."""
        return {}

    def motion(self) -> Motion | None:
        """A motion to judge an inverse on where no capture is given; None: a simulated performance, where it has shapes."""
        return None

    def skeleton(self) -> Skeleton | None:
        """The joints of a rig that is skinned and nothing else, for BVH, glTF and USD; None where there are none to tell."""
        return None

    def vertex_colors(self) -> Tensor | None:
        """Colours `(vertex, 3)` in [0, 1] for pictures, or None for plain clay."""
        return None

    def true_rig(self) -> "RigBackend":
        """The rig that evaluates what is trained on this one: itself, or the one that it stands for."""
        return self

    def some_vertices(self, rows: Tensor) -> nn.Module:
        """Controls `(batch, control)` to the vertices `rows` alone, `(batch, row, 3)`, mm, where `poses_some` says so.

        A large rig that does not end in a linear map is trained on by these alone (`riginv.rig.black_box`).
        """
        raise NotImplementedError(f"rig '{self.name}' poses all of its vertices at once")

    @abstractmethod
    def forward(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to vertices `(batch, vertex, 3)`, mm (the paper's L, Eq. 1)."""


class LinearRig(RigBackend):
    """A rig that ends in a linear map: vertices = rest + (f(controls) - f(neutral)) basis.

    Blendshape rigs are such, with f the weights of the shapes, and so is linear blend skinning, with f the numbers of the
    skinning matrices. Everything that riginv gains from mesh space rests on this (`riginv.rig.mesh_space`).

    Attributes:
        basis: `(coefficient, vertex, 3)`, mm per unit of each coefficient.
        coefficient_names: one for each coefficient.
        primary_count: of a blendshape rig, whose coefficients are weights in [0, 1], 0 at rest: how many shapes, counted from
            the first, are driven directly; those after them correct these (in-betweens, combinations). Else 0.
        loose_parts: `(part,)`: how far each part of the rig may go on its own, where no control moves it like that, as a
            standard deviation: the turns of joints. Empty where a rig has none.
        is_fitted: whether the basis was fitted to poses: the coefficients have the scale of these and no names.
        is_surrogate: whether it was trained to stand for another rig, which is its `true_rig()`.
    """

    is_fitted: bool = False
    is_surrogate: bool = False
    basis: Tensor
    loose_parts: Tensor

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
        self.register_buffer("loose_parts", rest_vertices.new_zeros(0), persistent=False)
        self.coefficient_names = tuple(coefficient_names or (f"coefficient_{i}" for i in range(len(basis))))
        self.primary_count = primary_count

    @property
    def has_blendshapes(self) -> bool:
        return self.primary_count > 0

    @abstractmethod
    def coefficients(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to coefficients `(batch, coefficient)`: the nonlinear part f of the rig."""

    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        """The coefficients `(batch, coefficient)` of controls `(batch, control)`, and their derivative by these.

        By automatic differentiation, or for a rig that is not differentiable by finite differences; a rig that knows its own
        derivative answers in its place.
        """
        if not self.differentiable:
            return finite_differences(self.coefficients, controls, self.lower, self.upper)
        with torch.enable_grad(), pure_torch():  # the gradients of all coefficients are taken at once, as no kernel can
            given = controls.detach().requires_grad_()
            found = self.coefficients(given)
            rows = torch.eye(found.shape[1]).to(found)[:, None].expand(-1, len(controls), -1)
            derivatives = torch.autograd.grad(found, given, rows, is_grads_batched=True)[0]
        return found.detach(), Jacobian(inner=derivatives.transpose(0, 1))

    def coefficients_and_pull(self, controls: Tensor) -> tuple[Tensor, Pull]:
        """The coefficients `(batch, coefficient)` of controls `(batch, control)`, and their pull: a vector-Jacobian product.

        The pull maps a gradient `(batch, coefficient)` to one of the controls, `(batch, control)`. Neither has a graph. This is
        automatic differentiation, or for a rig that is not differentiable finite differences; a rig that knows a faster way
        answers in its place.
        """
        if not self.differentiable:
            found, jacobian = self.coefficient_jacobian(controls)
            return found, jacobian.pull
        with torch.enable_grad():
            given = controls.detach().requires_grad_()
            found = self.coefficients(given)
        return found.detach(), lambda gradient: torch.autograd.grad(found, given, gradient, retain_graph=True)[0]

    def neutral_coefficients(self) -> Tensor:
        """The coefficients `(1, coefficient)` of the rest mesh."""
        return self.coefficients(self.neutral_controls[None])

    def posing_rig(self) -> RigBackend:
        """The rig that makes the meshes: itself, or the one that the basis was fitted to."""
        return self

    def poses_to_train_on(self, space: "MeshSpace") -> "PoseBatch | None":
        """The recorded poses to train on, in mesh coordinates; None: a rig that can be posed, at random."""
        return None

    def features(self, coefficients: Tensor) -> Tensor | None:
        """What of coefficients `(batch, coefficient)` tells about the controls: `(batch, feature)`, differentiable.

        An inverse looks at it in place of mesh coordinates. None where the coefficients say it as they are; a skeleton gives
        the turn of each joint against the one above it.
        """
        return None

    def feature_change(self, before: Tensor, after: Tensor) -> Tensor:
        """How features `(batch, feature)` changed; a rig with angles among them takes the shorter way round."""
        return after - before

    def loose_coefficients(self, controls: Tensor, parts: Tensor) -> Tensor:
        """Coefficients `(batch, coefficient)` near a pose: each part has gone on its own by `parts` `(batch, part)`."""
        return self.coefficients(controls)

    def forward(self, controls: Tensor) -> Tensor:
        change = self.coefficients(controls) - self.neutral_coefficients().to(controls)
        return apply_deltas(self.rest_vertices.to(controls), self.basis.to(controls), change)
