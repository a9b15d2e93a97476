"""The steps that draw meshes: the paper's two figures, and where on the head the errors lie."""

from collections.abc import Mapping
from typing import Any

import torch
from PIL import Image
from torch import Tensor

from riginv.errors import InputError
from riginv.geometry.neighbours import evenly
from riginv.inference.inverse import load_inverse
from riginv.meshes.rendering import Camera, Pair, comparison, grid, heat_colors
from riginv.reproduce.cast import rig_in_space, the_true_rig
from riginv.reproduce.judging import read_errors
from riginv.reproduce.sets import COMBINATIONS, the_sets
from riginv.reproduce.steps import Task
from riginv.reproduce.training import bundle_of
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.runs.files import atomic_write

PICTURE = "picture.png"
DENOISED, BODIES, BODY_FRAMES = 2, 3, 40
ROOM = 1.15
RED_SHARE = 0.995  # of the vertices lie below the error that is drawn in the darkest red


def denoising(task: Task) -> dict[str, Any]:
    """Random combinations of blendshapes beside what the judge makes of their inverse (paper, the denoising figure)."""
    rig = rig_in_space(task.config["rig"]).rig
    judge = the_true_rig(task.config["judge"], rig, 1)
    sets = the_sets(task.config["sets"], task.places, None, rig)
    meshes = sets.get(COMBINATIONS) or next(iter(sets.values()))
    inverse = load_inverse(bundle_of(task.inputs["network"]), rig)
    targets = torch.cat([meshes.vertices(row, row + 1) for row in evenly(DENOISED + 2, len(meshes)).tolist()[1:-1]])
    return _draw(task, judge, targets, judge(inverse(targets)), "a random combination")


def body(task: Task) -> dict[str, Any]:
    """Frames of a body's motion, or random poses where it has none, beside the poses recovered (paper, the body figure).

    Raises:
        InputError: the rig's motion does not fit it.
    """
    rig = rig_in_space(task.config["rig"]).rig
    judge = the_true_rig(task.config["judge"], rig, 1)
    motion = rig.motion()
    if motion is not None and motion.vertices.shape[1:] != rig.rest_vertices.shape:
        raise InputError(f"rig '{rig.name}': its motion has meshes of {motion.vertices.shape[1]} vertices")
    sets = the_sets(task.config["sets"], task.places, None, rig) if motion is None else {}
    frames = motion.vertices if motion is not None else _some(next(iter(sets.values())), BODY_FRAMES)
    targets = frames[evenly(BODIES + 1, len(frames))[1:]]
    inverse = load_inverse(bundle_of(task.inputs["network"]), rig)
    return _draw(task, judge, targets, judge(inverse(targets)), "the animation")


def error_maps(task: Task) -> dict[str, Any]:
    """The mean error of each vertex on the rest mesh: a row for each set, a head for each method."""
    rig = rig_in_space(task.config["rig"]).rig
    camera, pictures, labels = Camera(rig.rest_vertices), [], []
    camera.half_height *= ROOM  # for labels above
    columns: Mapping[str, str] = task.config["columns"]
    errors = {use: read_errors(task.inputs[use]) for use in columns}
    sets = [name for name in task.config["sets"] if all(f"{name}/vertex" in one for one in errors.values())]
    for name in sets:
        by_method = {use: errors[use][f"{name}/vertex"] for use in columns}
        top = float(torch.stack(list(by_method.values())).quantile(RED_SHARE))
        for use, by_vertex in by_method.items():
            pictures.append(camera.picture(rig.rest_vertices, rig.faces, heat_colors(by_vertex, top)))
            labels += [f"{columns[use]}\n{name.replace('_', ' ')}: red {top:.2g} mm"]
    _save(task, grid(pictures, labels, len(columns)))
    return {"sets": sets}


def _draw(task: Task, rig: RigBackend, targets: Tensor, results: Tensor, label: str) -> dict[str, Any]:
    pairs = [Pair(label, target, result) for target, result in zip(targets, results)]
    _save(task, comparison(rig, pairs))
    return {"mean_vertex_error_mm": float((results - targets).norm(dim=2).mean()), "judge": rig.name}


def _some(meshes: MeshSet, count: int) -> Tensor:
    return meshes.vertices(0, min(count, len(meshes)))


def _save(task: Task, picture: Image.Image) -> None:
    with atomic_write(task.folder / PICTURE) as beside:
        picture.convert("P", palette=Image.Palette.ADAPTIVE, colors=200).save(beside, format="PNG", optimize=True)
