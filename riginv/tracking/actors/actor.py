"""An actor: a neutral mesh in place of the rig's own, with the rig's displacements on top of it."""

from dataclasses import dataclass, field
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.rig.interface import LinearRig, RigBackend
from riginv.tracking.fixed_controls import FixedControlsRig

FEW = 6  # frames


@dataclass(frozen=True)
class Actor:
    """An actor's neutral.

    Attributes:
        neutral: in the rig's topology and space, `(vertex, 3)`, mm.
        offset: from the rig's rest mesh to it, `(vertex, 3)`, mm.
        scale: size of the actor's displacements relative to the rig's.
        source: where the neutral is from: a file, frames of the clip, or `solve`.
        notes: sentences for the user.
        facts: further numbers for curves.json.
    """

    neutral: Tensor
    offset: Tensor
    scale: float
    source: str
    notes: tuple[str, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def distance_mm(self) -> Tensor:
        """The distance of each vertex from the rig, `(vertex,)`."""
        return self.offset.norm(dim=1)

    @property
    def sentence(self) -> str:
        """A sentence on the distance of the actor from the rig."""
        mean, worst = float(self.distance_mm.mean()), float(self.distance_mm.max())
        size = "" if self.scale == 1 else f", displacements {self.scale:g} times the rig's"
        return f"{mean:.3g} mm from the rig on average, {worst:.3g} mm at most (neutral: {self.source}){size}"

    def as_json(self) -> dict[str, Any]:
        """For curves.json."""
        return {
            "neutral": self.source,
            "mean_offset_mm": round(float(self.distance_mm.mean()), 6),
            "max_offset_mm": round(float(self.distance_mm.max()), 6),
            "scale": self.scale,
            **self.facts,
        }


class ActorRig(FixedControlsRig):
    """A rig with an actor's neutral: neutral + scale times the rig's displacements.

    Mesh coordinates are those of the rig, so that networks trained on the rig serve the actor.
    """

    def __init__(self, rig: LinearRig, actor: Actor) -> None:
        super().__init__(rig, torch.arange(len(rig.controls), device=rig.device), rig.neutral_controls)
        self.rest_vertices = actor.neutral.to(rig.rest_vertices)
        self.basis = rig.basis if actor.scale == 1 else actor.scale * rig.basis
        self.scale, self.is_fitted, self.is_surrogate = actor.scale, rig.is_fitted, rig.is_surrogate

    def forward(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch vertex 3"]:
        return _on_actor(self.rig, self.rest_vertices, self.scale, controls)

    def expressions(self) -> dict[str, dict[str, float]]:
        return self.rig.expressions()

    def vertex_colors(self) -> Float[Tensor, "vertex 3"] | None:
        return self.rig.vertex_colors()


class PosedActor(RigBackend):
    """A rig that does not end in a linear map, with an actor's neutral."""

    def __init__(self, rig: RigBackend, actor: Actor) -> None:
        super().__init__(rig.name, rig.controls, actor.neutral.to(rig.rest_vertices), rig.faces)
        self.rig, self.scale, self.differentiable = rig, actor.scale, rig.differentiable

    def forward(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch vertex 3"]:
        return _on_actor(self.rig, self.rest_vertices, self.scale, controls)

    def vertex_colors(self) -> Float[Tensor, "vertex 3"] | None:
        return self.rig.vertex_colors()


def solved_notes(steps: int, frames: int) -> list[str]:
    """Sentences on a neutral that was solved for with some frames."""
    notes = [
        f"the neutral was found in {steps} steps: a control that never comes to rest in the clip may keep an error "
        f"(actor.neutral=FILE avoids it)"
    ]
    if frames < FEW:
        which = "one frame does" if frames == 1 else f"{frames} frames do"
        notes.append(f"{which} not tell the shape of a face from its expression: give actor.neutral=FILE, the actor at rest")
    return notes


def posed_actor(rig: RigBackend, actor: Actor | None) -> RigBackend:
    """A rig with the actor's neutral; the rig itself without an actor."""
    if actor is None:
        return rig
    return ActorRig(rig, actor) if isinstance(rig, LinearRig) else PosedActor(rig, actor)


def _on_actor(rig: RigBackend, neutral: Tensor, scale: float, controls: Tensor) -> Tensor:
    return neutral.to(controls) + scale * (rig(controls) - rig.rest_vertices.to(controls))
