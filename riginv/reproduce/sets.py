"""The mesh sets of a reproduction, and subsets of them."""

import functools
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.performance import simulated_performance
from riginv.config.typed import to_plain, to_typed
from riginv.errors import InputError
from riginv.evaluation.evaluation_sets import random_sets
from riginv.geometry.neighbours import evenly
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_sets import MeshSet
from riginv.tracking.capture import open_capture

COMBINATIONS, POSES, CAPTURED, CLIP = "random_combinations", "rig_poses", "captured", "clip"
CONTROLS_FILE, VERTICES_FILE = "controls.npy", "vertices.npy"


@dataclass(frozen=True)
class CaptureSource:
    """A clip as captured data, and how it is read.

    Attributes:
        path: None: a simulated performance.
    """

    path: str | None = None
    reading: ReadingOptions = field(default_factory=ReadingOptions)
    frames: FrameOptions = field(default_factory=FrameOptions)


@dataclass(frozen=True)
class SetSizes:
    """Sizes of the sets.

    Attributes:
        meshes: in each set except the clip.
        frames: of the clip; None: all.
        capture: hash of the content of the captured data; None: simulated.
    """

    meshes: int
    frames: int | None
    capture: str | None = None


class Subset(MeshSet):
    """Some meshes of another set.

    Args:
        rows: their indices, `(mesh,)`.
        fps: None: they are not consecutive frames.
    """

    def __init__(self, meshes: MeshSet, rows: Tensor, name: str | None = None, fps: float | None = None) -> None:
        controls = None if meshes.controls is None else meshes.controls[rows]
        numbers = None if meshes.frame_numbers is None else meshes.frame_numbers[rows]
        super().__init__(name or meshes.name, fps, controls, numbers)
        self.meshes, self.rows = meshes, rows.tolist()

    def __len__(self) -> int:
        return len(self.rows)

    def vertices(self, start: int, stop: int) -> Tensor:
        return torch.cat([self.meshes.vertices(row, row + 1) for row in self.rows[start:stop]])

    def known(self, start: int, stop: int) -> Tensor | None:
        masks = [mask for row in self.rows[start:stop] if (mask := self.meshes.known(row, row + 1)) is not None]
        return torch.cat(masks) if len(masks) == len(self.rows[start:stop]) else None


class SampledPoses(MeshSet):
    """Poses of the true rig, memory-mapped from the folder of their step."""

    controls: Tensor

    def __init__(self, folder: str | Path) -> None:
        controls = np.load(Path(folder) / CONTROLS_FILE, allow_pickle=False)
        super().__init__(POSES, controls=torch.from_numpy(controls))
        self._vertices = np.load(Path(folder) / VERTICES_FILE, mmap_mode="r", allow_pickle=False)

    def __len__(self) -> int:
        return len(self._vertices)

    def vertices(self, start: int, stop: int) -> Tensor:
        return torch.from_numpy(np.array(self._vertices[start:stop]))


def captured_data(rig: LinearRig, source: CaptureSource) -> MeshSet | None:
    """The captured data, or a simulated performance; read once per process; None: the rig has no blendshapes.

    Raises:
        InputError: the clip cannot be read, does not fit the rig, or has fewer than three frames.
    """
    return _captured_data(rig, json.dumps(to_plain(source)) if source.path else "")


@functools.lru_cache(maxsize=4)
def _captured_data(rig: LinearRig, text: str) -> MeshSet | None:
    if not text:
        return simulated_performance(rig)
    source = to_typed(json.loads(text), CaptureSource)
    path = str(source.path)
    meshes = open_capture(path, rig, rig, source.reading, source.frames)
    if len(meshes) < 3:
        raise InputError(f"{path}: {len(meshes)} frames, expected at least 3: roughness is a second difference")
    return meshes


def spread_subset(rig: LinearRig, source: CaptureSource, meshes: int) -> MeshSet | None:
    """Evenly spread meshes of the captured data."""
    data = captured_data(rig, source)
    return None if data is None else Subset(data, evenly(meshes, len(data)), CAPTURED)


def middle_clip(rig: LinearRig, source: CaptureSource, frames: int | None) -> MeshSet | None:
    """Consecutive frames from the middle of the captured data.

    Args:
        frames: None: all.
    """
    data = captured_data(rig, source)
    if data is None:
        return None
    count = min(frames or len(data), len(data))
    start = (len(data) - count) // 2
    return Subset(data, torch.arange(start, start + count), CLIP, data.fps)


def mesh_sets(sizes: SetSizes, source: CaptureSource, rig: LinearRig, poses: str | None = None) -> dict[str, MeshSet]:
    """All sets by name.

    Args:
        poses: folder of the test poses; None: without these.
    """
    sets = [one for one in random_sets(rig, sizes.meshes) if one.name != POSES]
    data = spread_subset(rig, source, sizes.meshes), middle_clip(rig, source, sizes.frames)
    sets += [one for one in data if one is not None]
    if poses:
        sampled = SampledPoses(poses)
        sets.append(Subset(sampled, torch.arange(min(sizes.meshes, len(sampled)))))
    return {one.name: one for one in sets}
