"""The meshes that a reproduction judges on, and parts of sets."""

import functools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from riginv.clips.options import clip_options
from riginv.clips.performance import simulated_performance
from riginv.errors import InputError
from riginv.evaluation.evaluation_sets import random_sets
from riginv.geometry.neighbours import evenly
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_sets import MeshSet, StoredMeshes
from riginv.tracking.capture import open_capture

COMBINATIONS, POSES, CAPTURED, CLIP = "random_combinations", "rig_poses", "captured", "clip"
CAPTURE_KEYS = ("capture", "reading", "frames")  # of a config: the clip that stands for captured data, and how it is read
CONTROLS_FILE, VERTICES_FILE = "controls.npy", "vertices.npy"


class Rows(MeshSet):
    """Some meshes of another set.

    Args:
        rows: which, `(mesh,)`.
        fps: where they are frames in a row, else None.
    """

    def __init__(self, meshes: MeshSet, rows: Tensor, name: str | None = None, fps: float | None = None) -> None:
        controls, numbers = (None if values is None else values[rows] for values in (meshes.controls, meshes.frame_numbers))
        super().__init__(name or meshes.name, fps, controls, numbers)
        self.meshes, self.rows = meshes, rows.tolist()

    def __len__(self) -> int:
        return len(self.rows)

    def vertices(self, start: int, stop: int) -> Tensor:
        return torch.cat([self.meshes.vertices(row, row + 1) for row in self.rows[start:stop]])

    def known(self, start: int, stop: int) -> Tensor | None:
        masks = [self.meshes.known(row, row + 1) for row in self.rows[start:stop]]
        return None if any(mask is None for mask in masks) else torch.cat(masks)


class KeptPoses(StoredMeshes):
    """Poses that the judge made, kept as files: read as they are asked for, never all at once."""

    def __init__(self, folder: str | Path) -> None:
        controls, vertices = (
            np.load(Path(folder) / name, mmap_mode="r", allow_pickle=False) for name in (CONTROLS_FILE, VERTICES_FILE)
        )
        super().__init__(POSES, vertices, controls=torch.from_numpy(np.array(controls)))

    def vertices(self, start: int, stop: int) -> Tensor:
        return torch.from_numpy(np.array(self.meshes[start:stop]))


def recording(rig: LinearRig, places: Mapping[str, Any]) -> MeshSet | None:
    """The captured data, read once in a process: the clip given, or a simulated performance; None: the rig has no shapes.

    Args:
        places: `capture`, the path of the clip or None, and how it is read: `reading` and `frames`.

    Raises:
        InputError: the clip cannot be read, is none of the rig, or is shorter than three frames.
    """
    return _recording(rig, json.dumps({key: places[key] for key in CAPTURE_KEYS}) if places["capture"] else "")


@functools.lru_cache(maxsize=4)
def _recording(rig: LinearRig, given: str) -> MeshSet | None:
    places = json.loads(given) if given else {}
    whole = open_capture(places["capture"], rig, rig, *clip_options(places)) if places else simulated_performance(rig)
    if whole is not None and len(whole) < 3:
        raise InputError(f"{places['capture']}: {len(whole)} frames, expected at least 3: roughness is a second difference")
    return whole


def captured(rig: LinearRig, places: Mapping[str, Any], meshes: int) -> MeshSet | None:
    """Some meshes of the captured data, evenly spread over the whole of it."""
    whole = recording(rig, places)
    return None if whole is None else Rows(whole, evenly(meshes, len(whole)), CAPTURED)


def the_clip(rig: LinearRig, places: Mapping[str, Any], frames: int | None) -> MeshSet | None:
    """Frames of the captured data in a row, from its middle; None: all of them."""
    whole = recording(rig, places)
    if whole is None:
        return None
    count = min(frames or len(whole), len(whole))
    start = (len(whole) - count) // 2
    return Rows(whole, torch.arange(start, start + count), CLIP, whole.fps)


def the_sets(config: Mapping[str, Any], places: Mapping[str, Any], poses: str | None, rig: LinearRig) -> dict[str, MeshSet]:
    """All sets by name; poses of the rig are those that the judge made (`poses`: their folder).

    Args:
        config: `meshes` in each set but the clip, `frames` of the clip, None: all.
        places: as for `recording`.
    """
    sets = [one for one in random_sets(rig, config["meshes"]) if one.name != POSES]
    data = captured(rig, places, config["meshes"]), the_clip(rig, places, config["frames"])
    sets += [one for one in data if one is not None]
    if poses:
        kept = KeptPoses(poses)
        sets.append(Rows(kept, torch.arange(min(config["meshes"], len(kept)))))
    return {one.name: one for one in sets}
