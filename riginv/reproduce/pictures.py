"""The steps that render meshes: the paper's two figures, and maps of the errors."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from PIL import Image
from torch import Tensor

from riginv.config.building import ClassSpec
from riginv.errors import InputError
from riginv.geometry.neighbours import evenly
from riginv.inference.inverse import load_inverse
from riginv.meshes.rendering import Camera, Pair, comparison, grid, heat_colors
from riginv.reproduce.evaluation import read_errors
from riginv.reproduce.rigs import rig_in_space, true_rig
from riginv.reproduce.sets import COMBINATIONS, mesh_sets
from riginv.reproduce.steps import Figures, Task, Workspace
from riginv.reproduce.training import bundle_of
from riginv.rig.interface import LinearRig, RigBackend
from riginv.runs.files import atomic_write

PICTURE = "picture.png"
DENOISED, BODIES, BODY_FRAMES = 2, 3, 40
ROOM = 1.15
RED_SHARE = 0.995  # of the vertices lie below the error that is drawn in the darkest red


@dataclass(frozen=True)
class DrawDenoising(Task):
    """Draw random combinations of blendshapes beside the true rig, posed by their inverse (paper, the denoising figure).

    Attributes:
        true_rig: None: the programmatic rig.
    """

    draws: ClassVar[bool] = True
    true_rig: ClassSpec[RigBackend] | None

    def run(self, at: Workspace) -> Figures:
        rig = rig_in_space(self.rig).source
        sets = mesh_sets(self.sets, at.context.capture, rig)
        meshes = sets.get(COMBINATIONS) or next(iter(sets.values()))
        targets = torch.cat([meshes.vertices(row, row + 1) for row in evenly(DENOISED + 2, len(meshes)).tolist()[1:-1]])
        return _draw(at, rig, self.true_rig, targets, "a random combination")


@dataclass(frozen=True)
class DrawBody(Task):
    """Draw frames of a body's motion, or random poses if it has none, beside the recovered poses (paper, the body figure).

    Attributes:
        true_rig: None: the programmatic rig.
    """

    draws: ClassVar[bool] = True
    true_rig: ClassSpec[RigBackend] | None

    def run(self, at: Workspace) -> Figures:
        """Draw the figure.

        Raises:
            InputError: the rig's motion does not fit it.
        """
        rig = rig_in_space(self.rig).source
        motion = rig.motion()
        if motion is None:
            meshes = next(iter(mesh_sets(self.sets, at.context.capture, rig).values()))
            frames = meshes.vertices(0, min(BODY_FRAMES, len(meshes)))
        else:
            frames = motion.vertices
        if frames.shape[1:] != rig.rest_vertices.shape:
            raise InputError(f"rig '{rig.name}': its motion has meshes of {frames.shape[1]} vertices")
        targets = frames[evenly(BODIES + 1, len(frames))[1:]]
        return _draw(at, rig, self.true_rig, targets, "the animation")


@dataclass(frozen=True)
class DrawErrorMaps(Task):
    """Draw the mean error of each vertex on the rest mesh: a row for each set, a column for each method.

    Attributes:
        columns: labels, by the use of an input.
        names: of the sets.
    """

    draws: ClassVar[bool] = True
    columns: Mapping[str, str]
    names: tuple[str, ...]

    def run(self, at: Workspace) -> Figures:
        rig = rig_in_space(self.rig).source
        camera, pictures, labels = Camera(rig.rest_vertices), [], []
        camera.half_height *= ROOM  # for labels above
        errors = {use: read_errors(at.inputs[use]) for use in self.columns}
        names = [name for name in self.names if all(f"{name}/vertex" in one for one in errors.values())]
        for name in names:
            by_method = {use: errors[use][f"{name}/vertex"] for use in self.columns}
            top = float(torch.stack(list(by_method.values())).quantile(RED_SHARE))
            for use, by_vertex in by_method.items():
                pictures.append(camera.picture(rig.rest_vertices, rig.faces, heat_colors(by_vertex, top)))
                labels += [f"{self.columns[use]}\n{name.replace('_', ' ')}: red {top:.2g} mm"]
        _save(at, grid(pictures, labels, len(self.columns)))
        return {"sets": names}


def _draw(at: Workspace, rig: LinearRig, named: ClassSpec[RigBackend] | None, targets: Tensor, label: str) -> Figures:
    """Draw meshes beside the true rig at the controls that the network finds for them."""
    reference = true_rig(named, rig, 1)
    results = reference(load_inverse(bundle_of(at.inputs["network"]), rig)(targets))
    pairs = [Pair(label, target, result) for target, result in zip(targets, results)]
    _save(at, comparison(reference, pairs))
    return {"mean_vertex_error_mm": float((results - targets).norm(dim=2).mean()), "true_rig": reference.name}


def _save(at: Workspace, picture: Image.Image) -> None:
    with atomic_write(at.folder / PICTURE) as partial:
        picture.convert("P", palette=Image.Palette.ADAPTIVE, colors=200).save(partial, format="PNG")
