"""An actor in the folder of a result: its neutral as an OBJ, the offset field as an .npz, and a picture."""

from pathlib import Path

import numpy as np
from torch import Tensor

from riginv.meshes.obj import obj_text
from riginv.meshes.rendering import Camera, grid, heat_colors
from riginv.runs.files import atomic_write, write_text
from riginv.tracking.actors.actor import Actor
from riginv.tracking.viewer.page import in_mm

MESH, FIELD, PICTURE = "actor.obj", "actor.npz", "actor.png"


def write_actor(folder: Path, actor: Actor, faces: Tensor, picture: bool) -> list[str]:
    """Write `actor.obj`, `actor.npz` and optionally `actor.png`; returns their names.

    The .npz has `offset` and `neutral`, `(vertex, 3)`, in mm, y up, and `scale`.
    """
    neutral, offset = (values.cpu().numpy() for values in (actor.neutral, actor.offset))
    write_text(folder / MESH, obj_text(neutral.astype(np.float64), faces.cpu().numpy()))
    with atomic_write(folder / FIELD) as beside, beside.open("wb") as file:
        np.savez(file, offset=offset, neutral=neutral, scale=np.float64(actor.scale))
    if not picture:
        return [MESH, FIELD]
    rest, distance = actor.neutral - actor.offset, actor.distance_mm
    camera = Camera(rest)
    top = float(distance.max().clamp_min(0.01))
    pictures = [
        camera.picture(rest, faces),
        camera.picture(actor.neutral, faces),
        camera.picture(actor.neutral, faces, heat_colors(distance, top)),
    ]
    labels = ["rig at rest", "actor at rest", f"offset: mean {in_mm(float(distance.mean()))} mm, red is {top:.2g} mm"]
    with atomic_write(folder / PICTURE) as beside:
        grid(pictures, labels, columns=3).save(beside, format="PNG")
    return [MESH, FIELD, PICTURE]
