"""Pictures of what was asked for beside what came out."""

from typing import NamedTuple

from PIL import Image
from torch import Tensor

from riginv.render import Camera, grid, heat_colors
from riginv.rig import RigBackend


class Pair(NamedTuple):
    """A mesh that was asked for and the one that came out, each `(vertex, 3)`, mm, and what to call them."""

    label: str
    target: Tensor
    result: Tensor


def comparison(rig: RigBackend, pairs: list[Pair]) -> Image.Image:
    """A row for each pair: target, result, and the error as heat, up to the largest of its row."""
    camera, faces, colors = Camera(rig.rest_vertices), rig.faces, rig.vertex_colors()
    colors = None if colors is None else colors.cpu()
    pictures, labels = [], []
    for label, target, result in pairs:
        distances = (result - target).norm(dim=1)
        top = float(distances.max())
        heat = heat_colors(distances, top)
        view = camera.following(target, result)
        pictures += [view.picture(target, faces, colors), view.picture(result, faces, colors)]
        pictures += [view.picture(result, faces, heat)]
        labels += [label, "result", f"error: mean {float(distances.mean()):.2f}, red {top:.1f} mm"]
    return grid(pictures, labels, columns=3)
