"""The cube of the paper's released code, with eight distinct corners, a true neutral and scales that stay above 0."""

import itertools

import roma
import torch

from riginv.rig.interface import Control, LinearRig

FACES = [
    [0, 1, 3],
    [0, 3, 2],
    [4, 6, 7],
    [4, 7, 5],
    [0, 4, 5],
    [0, 5, 1],
    [2, 3, 7],
    [2, 7, 6],
    [0, 2, 6],
    [0, 6, 4],
    [1, 5, 7],
    [1, 7, 3],
]


class CubeRig(LinearRig):
    """Six controls: how far the cube is turned about x, y and z, and how far it is stretched along its own axes.

    Args:
        size: the edge of the cube at rest, mm.
    """

    def __init__(self, size: float) -> None:
        controls = [Control(f"turn_{axis}", lower=-45.0, upper=45.0, unit="deg") for axis in "xyz"]
        controls += [Control(f"stretch_{axis}", lower=0.5, upper=2.0, neutral=1.0) for axis in "xyz"]
        corners = torch.tensor(list(itertools.product((-1.0, 1.0), repeat=3))) * size / 2
        # Number (row, column) of the matrix adds column's coordinate of each corner to row's coordinate of its vertex.
        basis = torch.einsum("ri,vc->rcvi", torch.eye(3), corners).flatten(0, 1)
        super().__init__("cube", controls, corners, torch.tensor(FACES), basis)

    def coefficients(self, controls: torch.Tensor) -> torch.Tensor:
        """Controls `(batch, 6)` to the nine numbers `(batch, 9)` of the matrix that moves every corner."""
        turns, stretches = controls[:, :3].deg2rad(), controls[:, 3:]
        rotation = roma.euler_to_rotmat("xyz", turns)  # about x first, about the axes of the world
        return (rotation * stretches[:, None, :]).flatten(1)

    def expressions(self) -> dict[str, dict[str, float]]:
        return {
            "a plank": {"stretch_x": 2.0, "stretch_y": 0.5},
            "a tower, turned": {"stretch_y": 2.0, "turn_y": 40.0, "turn_z": -20.0},
        }

    def vertex_colors(self) -> torch.Tensor:
        return (self.rest_vertices > 0) * 0.55 + 0.3
