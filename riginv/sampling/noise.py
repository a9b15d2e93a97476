"""Capture noise, in mesh coordinates: its projection onto the rig's mesh space."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import MeshSpace

BUMPS = 128  # smooth displacement fields whose random combinations are the smooth noise
BUMP_SEED = 20221206


class CaptureNoise(nn.Module):
    """Per-vertex noise and smooth displacement, both Gaussian, of a given size on every mesh.

    White noise of the vertices is white in an orthonormal frame, too, so it is drawn in mesh coordinates. Smooth noise combines
    bumps: each displaces the vertices around a random one in a random direction, with a Gaussian fall-off.

    Args:
        vertex_mm: standard deviation of the noise of each vertex and axis, mm.
        smooth_mm: root mean square length of the smooth displacement over mesh and batch, mm.
        radius_mm: standard deviation of the fall-off of a bump, mm.

    Raises:
        InputError: a size is negative, or the radius is not positive.
    """

    smooth: Tensor

    def __init__(self, space: MeshSpace, vertex_mm: float = 0.0, smooth_mm: float = 0.0, radius_mm: float = 25.0) -> None:
        super().__init__()
        if vertex_mm < 0 or smooth_mm < 0 or radius_mm <= 0:
            raise InputError(
                f"noise: vertex_mm {vertex_mm} and smooth_mm {smooth_mm} must be at least 0, radius_mm {radius_mm} above 0"
            )
        self.vertex_mm, self.smooth_mm = vertex_mm, smooth_mm
        self.size = space.size
        rest = space.rest_vertices
        generator = generator_at(BUMP_SEED, "bumps")
        centres = rest[torch.randint(len(rest), (BUMPS,), generator=generator)]
        directions = torch.randn(BUMPS, 3, generator=generator).to(rest)
        fall_off = torch.exp(-0.5 * (torch.cdist(centres, rest) / radius_mm) ** 2)
        fields = fall_off[..., None] * directions[:, None]
        fields = fields / fields.square().sum(dim=(0, 2)).mean().sqrt()
        self.register_buffer("smooth", space.encode(rest + fields), persistent=False)

    def sample(self, count: int, generator: torch.Generator) -> Float[Tensor, "count coordinate"]:
        """Noise `(count, coordinate)` to add to mesh coordinates."""
        mixing = torch.randn(count, len(self.smooth), generator=generator, device=generator.device)
        white = torch.randn(count, self.size, generator=generator, device=generator.device)
        return self.smooth_mm * (mixing @ self.smooth) + self.vertex_mm * white
