"""An animated avatar as a clip: its meshes at each frame, morph weights and skins evaluated."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import roma
import torch

from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, Polygons
from riginv.clips.units import DEFAULT_FPS
from riginv.errors import InputError
from riginv.geometry.kinematics import transform_from
from rigs.gltf.animation import Channel, read_channels
from rigs.gltf.avatar import blended, turned
from rigs.gltf.container import open_gltf
from rigs.gltf.pieces import chosen_nodes, pieces
from rigs.gltf.scene import Scene, read_scene
from rigs.gltf.targets import default_weights, target_names

METRE = 1000.0  # mm, the unit of glTF
EVEN = 0.02  # of a frame, that keys may be off an even spacing
MOST_FRAMES = 1_000_000
LOCAL = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


class GltfClip(MeshSequence):
    """The first animation of a .glb, .gltf or .vrm, sampled frame by frame.

    Args:
        path: of the file.
        options: `mesh`: the name of a mesh or its node; None: all that can move, in the order of the file, as `rig=gltf` takes
            them. `fps`: to sample at; None: what its keys are spaced by, where they are even, else 30.

    Raises:
        InputError: the file cannot be read, or holds no animation.
    """

    def __init__(self, path: str, options: ReadingOptions) -> None:
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file; clip=PATH names a clip")
        self.file = open_gltf(path)
        self.scene = read_scene(self.file)
        try:
            chosen = chosen_nodes(self.file, self.scene, options.mesh_names, [], joints=True)
        except InputError as error:  # a clip is told so by another key than a rig
            raise InputError(str(error).replace("rig.include", "reading.mesh")) from None
        self.pieces = pieces(self.file, chosen)
        names = target_names(self.file, sorted({piece.mesh for piece in self.pieces}))
        nodes = self.file.document["nodes"]
        self.weights = {
            piece.node: default_weights(self.file, piece.mesh, nodes[piece.node], names[piece.mesh]) for piece in self.pieces
        }
        self.channels = read_channels(self.file, {node: len(found) for node, found in self.weights.items()})
        start = min(channel.times[0] for channel in self.channels)
        end = max(channel.times[-1] for channel in self.channels)
        rate = _positive(options.fps) or _rate(self.channels) or DEFAULT_FPS
        if not (end - start) * rate < MOST_FRAMES:
            raise InputError(f"{path}: {end - start:.3g} s at {rate:g} frames a second are more than can be meant: damaged?")
        self.times = start + np.arange(round((end - start) * rate) + 1) / rate
        self.at_rest = [(piece.positions(self.file).astype(np.float64), dict(piece.deltas(self.file))) for piece in self.pieces]
        count = sum(piece.count for piece in self.pieces)
        triangles = [piece.start + piece.triangles(self.file) for piece in self.pieces]
        numbers = np.arange(len(self.times)) + round(start * rate)
        super().__init__(path, numbers, count, Polygons.triangles(np.concatenate(triangles)), rate, METRE, "y")

    def read(self, start: int, stop: int) -> np.ndarray:
        times = self.times[start:stop]
        moves: dict[int, dict[str, np.ndarray]] = {}
        for channel in self.channels:
            moves.setdefault(channel.node, {})[channel.what] = channel.at(times)
        values = np.empty((len(times), self.vertex_count, 3))
        with np.errstate(over="ignore", invalid="ignore"):
            for frame, meshes in enumerate(values):
                self._pose(meshes, {node: {what: found[frame] for what, found in move.items()} for node, move in moves.items()})
        return values.astype(np.float32)

    def _pose(self, vertices: np.ndarray, moves: dict[int, dict[str, np.ndarray]]) -> None:
        """Write the vertices `(vertex, 3)`, metres, of nodes that stand as `moves` say."""
        scene = self._posed(moves)
        for piece, (positions, deltas) in zip(self.pieces, self.at_rest):
            weights = moves.get(piece.node, {}).get("weights")
            weights = dict(zip(self.weights[piece.node], weights)) if weights is not None else self.weights[piece.node]
            points = positions + sum(weights[name] * delta for name, delta in deltas.items() if weights[name])
            blend = blended(piece.carriers(self.file, scene), slice(None), 1.0)
            vertices[piece.vertices] = turned(blend, points) + blend[:, :, 3]

    def _posed(self, moves: dict[int, dict[str, np.ndarray]]) -> Scene:
        turning, scaling = self.scene.turning.clone(), self.scene.scaling.clone()
        for node, move in moves.items():
            if not move.keys() & LOCAL.keys():
                continue
            own = self.file.document["nodes"][node]
            if "matrix" in own:
                raise InputError(f"{self.path}: node {node} has a matrix and is animated, which glTF forbids: export it again")
            local = {what: torch.tensor(_vector(move, own, what), dtype=torch.float64) for what in LOCAL}
            length = local["rotation"].norm().clamp_min(1e-9)
            turn = roma.unitquat_to_rotmat(local["rotation"] / length)
            turning[node] = transform_from(turn, local["translation"])
            scaling[node] = transform_from(torch.diag(local["scale"]), torch.zeros(3, dtype=torch.float64))
        return replace(self.scene, turning=turning, scaling=scaling)


def _vector(move: dict[str, np.ndarray], own: dict[str, Any], what: str) -> np.ndarray:
    return np.asarray(move.get(what, own.get(what, LOCAL[what])), np.float64)


def _positive(fps: Any) -> float | None:
    return float(fps) if isinstance(fps, int | float) and 0 < fps < 1e6 else None


def _rate(channels: list[Channel]) -> float | None:
    """Frames a second, where the channel with the most keys has them evenly spaced."""
    times = max((channel.times for channel in channels), key=len)
    steps = np.diff(times)
    if not len(steps) or not (steps > 0).all():
        return None
    step = (times[-1] - times[0]) / len(steps)
    return round(float(1 / step), 3) if np.abs(steps - step).max() < EVEN * step and step > 1e-6 else None
