"""A rig that is small enough to train in seconds, with everything that a real one has: curves, a two-sided control, a macro."""

import torch
import trimesh
from torch import Tensor

from riginv.geometry.blendshapes import combination_weights, screen
from riginv.geometry.curves import Key, evaluate_curves, pack_curves
from riginv.rig.batches import generator_at
from riginv.rig.interface import Control, LinearRig, RigBackend

SHAPES, COMBINATIONS = 8, 4


class ToyRig(LinearRig):
    """A sphere of 162 vertices, 7 controls and 12 blendshapes.

    Args:
        detail: subdivisions of the sphere.
        last_name: the name of the last control.
    """

    def __init__(self, detail: int = 2, last_name: str = "all", arkit: bool = False) -> None:
        sphere = trimesh.creation.icosphere(detail, radius=50.0)
        rest = torch.tensor(sphere.vertices, dtype=torch.float32)
        centres = torch.nn.functional.normalize(torch.randn(SHAPES, 3, generator=generator_at(0, "toy")), dim=1) * 50
        weight = torch.exp(-0.5 * (torch.cdist(centres, rest) / 25) ** 2)
        shapes = weight[..., None] * torch.randn(SHAPES, 1, 3, generator=generator_at(1, "toy")) * 6
        members = torch.tensor([[0, 1, -1], [2, 3, -1], [4, 5, -1], [0, 2, 4]])
        repairs = -0.5 * shapes[members[:, 0]] * weight[members[:, 1], :, None]
        controls = [Control(f"bump{number}") for number in range(5)]
        controls += [Control("side", lower=-1.0), Control(last_name)]
        names = [f"shape{number}" for number in range(SHAPES)] + [f"repair{number}" for number in range(COMBINATIONS)]
        super().__init__("toy", controls, rest, torch.tensor(sphere.faces), torch.cat([shapes, repairs]), names, SHAPES)
        rise = [Key(0.0, 0.0, right=(0.4, 0.2)), Key(1.0, 1.0, left=(-0.3, -0.3))]
        fall = [Key(-1.0, 1.0, right=(0.3, -0.3)), Key(0.0, 0.0, left=(-0.4, 0.2))]
        self.register_buffer("source", torch.tensor([0, 1, 2, 3, 4, 5, 5, 6, 6]), persistent=False)
        self.register_buffer("curves", pack_curves([rise] * 5 + [fall, rise, rise, rise]).float(), persistent=False)
        drivers = [[0, -1], [1, 7], [2, -1], [3, 8], [4, -1], [5, -1], [6, -1], [7, -1]]
        self.register_buffer("drivers", torch.tensor(drivers), persistent=False)
        self.register_buffer("members", members, persistent=False)
        self.arkit = arkit

    def coefficients(self, controls: Tensor) -> Tensor:
        driven = evaluate_curves(self.curves.to(controls), controls[:, self.source])
        primary = screen(driven, self.drivers)
        return torch.cat([primary, combination_weights(primary, self.members)], dim=1)

    def arkit_deltas(self) -> dict[str, Tensor]:
        return {"jawOpen": self.basis[0], "mouthFunnel": self.basis[1]} if self.arkit else {}


class Plain(RigBackend):
    """A rig that is differentiable and does not say that it ends in a linear map."""

    def __init__(self) -> None:
        toy = ToyRig()
        super().__init__("plain", toy.controls, toy.rest_vertices, toy.faces)
        self.toy = toy

    def forward(self, controls: Tensor) -> Tensor:
        return self.toy(controls)


class BlackBox(RigBackend):
    """A rig that gives meshes but no gradients and no linear map."""

    differentiable = False

    def __init__(self) -> None:
        toy = ToyRig()
        super().__init__("black box", toy.controls, toy.rest_vertices, toy.faces)
        self.toy = toy

    @torch.no_grad()
    def forward(self, controls: Tensor) -> Tensor:
        return self.toy(controls)
