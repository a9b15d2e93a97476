"""A simulated performance, for those who have no captured one at hand: strokes of ARKit shapes, added linearly."""

import torch
from torch import Tensor

from riginv.data.mesh_sets import WeightedShapes
from riginv.errors import InputError
from riginv.rig import LinearRig, RigBackend
from riginv.sampling.seeds import generator_at

SEED = 20221206
FPS = 30.0
TOGETHER = 0.7  # how often a right shape moves with its left one


def simulated_performance(rig: RigBackend, frames: int = 900, name: str = "simulated_performance") -> WeightedShapes | None:
    """A clip of a rig with ARKit or other blendshapes: each shape rises and falls now and then, smoothly.

    Returns:
        the clip, or None for a rig without shapes to add: it has no clip, and is judged on its random poses alone.

    Raises:
        InputError: fewer than one frame is asked for.
    """
    if frames < 1:
        raise InputError(f"a performance of {frames} frames was asked for, expected at least 1")
    shapes = rig.arkit_deltas()
    if not shapes and isinstance(rig, LinearRig) and rig.has_blendshapes:
        count = rig.primary_count
        shapes = dict(zip(rig.coefficient_names[:count], rig.basis[:count]))
    if not shapes:
        return None
    curves = _strokes(list(shapes), frames)
    return WeightedShapes(name, rig.rest_vertices, torch.stack(list(shapes.values())), curves.to(rig.dtype), FPS)


def _strokes(names: list[str], frames: int) -> Tensor:
    """Curves `(frame, shape)` in [0, 1]: about one stroke of half a second to three in ten seconds for each shape."""
    time = torch.arange(frames) / FPS
    curves = torch.zeros(frames, len(names))
    drawn: dict[str, Tensor] = {}
    for column, name in enumerate(names):
        stem = name.removesuffix("Left").removesuffix("Right")
        generator = generator_at(SEED, "strokes", name)
        alone = float(torch.rand((), generator=generator)) > TOGETHER
        if alone or stem not in drawn:
            strokes = max(1, round(frames / FPS / 10))
            start = torch.rand(strokes, generator=generator) * frames / FPS
            length = 0.5 + 2.5 * torch.rand(strokes, generator=generator)
            height = torch.rand(strokes, generator=generator)
            place = ((time[:, None] - start) / length).clamp(0, 1)
            drawn[stem] = (height * (torch.sin(torch.pi * place) ** 2)).amax(dim=1)
        curves[:, column] = drawn[stem]
    return curves
