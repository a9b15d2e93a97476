"""Inversions of meshes at hand, with options as keyword arguments."""

from typing import Any

import numpy as np
import torch

from riginv.clips.clip import Clip
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, Polygons
from riginv.clips.units import resolve_units
from riginv.config.typed import convert
from riginv.rig.interface import LinearRig
from riginv.tracking.assembly import build_parts
from riginv.tracking.options import ControlOptions, SolverOptions, TrackingOptions, VertexOptions
from riginv.tracking.run import Inversion, invert_clip, invert_smoothly

GROUPS = {"controls": ControlOptions, "solver": SolverOptions, "vertices": VertexOptions}


class Given(MeshSequence):
    """Meshes that are at hand."""

    def __init__(self, meshes: torch.Tensor, faces: torch.Tensor, numbers: np.ndarray | None = None) -> None:
        numbers = np.arange(len(meshes)) if numbers is None else numbers
        super().__init__("given.npz", numbers, meshes.shape[1], Polygons.triangles(faces.numpy()), 30.0, 1.0, "y")
        self.meshes = meshes.float().numpy()

    def read(self, start: int, stop: int) -> np.ndarray:
        return self.meshes[start:stop]


def options(**changes: Any) -> TrackingOptions:
    groups = {name: convert(value, GROUPS[name], name) for name, value in changes.items() if name in GROUPS}
    return TrackingOptions(**{"method": "levenberg_marquardt", "motion": "keep", **changes, **groups})


def inverted(rig: LinearRig, meshes: torch.Tensor, numbers: np.ndarray | None = None, **changes: Any) -> Inversion:
    frames = changes.pop("frames", {})
    settings, sequence = options(**changes), Given(meshes, rig.faces, numbers)
    clip = Clip(sequence, resolve_units(sequence, rig, ReadingOptions(unit="mm", up="y")), **frames)
    parts = build_parts(settings, clip, rig, rig, None)
    arguments = (clip, parts.inverter, parts.evaluator, settings.window, lambda what, frames: None)
    if parts.method == "clip":
        return invert_smoothly(*arguments, settings.solver)
    return invert_clip(*arguments)


@torch.no_grad()
def error_mm(rig: LinearRig, found: Inversion, meshes: torch.Tensor) -> float:
    return float((rig(found.controls) - meshes).norm(dim=2).mean())
