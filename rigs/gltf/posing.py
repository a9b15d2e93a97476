"""Meshes in the poses that an animation gives their nodes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import roma
import torch

from riginv.errors import InputError
from riginv.geometry.kinematics import transform_from
from rigs.gltf.animation import ROTATION, SCALE, TRANSLATION, WEIGHTS, Channel
from rigs.gltf.avatar import blended, turned
from rigs.gltf.container import GltfFile
from rigs.gltf.pieces import Piece, pieces
from rigs.gltf.scene import Scene
from rigs.gltf.targets import default_weights

LOCAL = {TRANSLATION: (0.0, 0.0, 0.0), ROTATION: (0.0, 0.0, 0.0, 1.0), SCALE: (1.0, 1.0, 1.0)}

Moves = Mapping[int, Mapping[str, np.ndarray]]  # of nodes: what moves them, and its values


def moves_at(channels: Sequence[Channel], times: np.ndarray) -> list[Moves]:
    """Where channels put things at each of some times `(time,)`."""
    found: list[dict[int, dict[str, np.ndarray]]] = [{} for _ in times]
    for channel in channels:
        for moves, values in zip(found, channel.at(times)):
            moves.setdefault(channel.node, {})[channel.what] = values
    return found


class PosedMeshes:
    """Meshes of a file, posed.

    Args:
        nodes: those whose meshes are taken, in the order of their vertices.

    Attributes:
        pieces: where vertices come from, in the order of the file's vertices.
        vertex_count: of all of them.
        carrying: the nodes that carry vertices, themselves or by nodes below them.
        morphing: the nodes whose morph weights move vertices.
    """

    def __init__(self, file: GltfFile, scene: Scene, nodes: list[int]) -> None:
        self.file, self.scene = file, scene
        self.pieces = pieces(file, nodes)
        self.vertex_count = sum(piece.count for piece in self.pieces)
        self._bindings = [piece.binding(file, scene) for piece in self.pieces]
        self._at_rest = [(piece.positions(file), self._deltas(piece)) for piece in self.pieces]
        self._weights: dict[int, dict[str, float]] = {}
        self.carrying = self._carrying()
        self.morphing = {piece.node for piece, (_, deltas) in zip(self.pieces, self._at_rest) if deltas}

    def faces(self) -> np.ndarray:
        """Triangles `(face, 3)`."""
        return np.concatenate([piece.start + piece.triangles(self.file) for piece in self.pieces])

    def follows(self, channel: Channel) -> bool:
        """Whether a channel acts on any vertex."""
        return channel.node in (self.morphing if channel.what == WEIGHTS else self.carrying)

    def vertices(self, moves: Moves) -> np.ndarray:
        """Vertices `(vertex, 3)` in the world, metres, where nodes stand as `moves` say, and the others as at rest."""
        scene = self._posed(moves)
        result = np.empty((self.vertex_count, 3))
        for piece, bound, (positions, deltas) in zip(self.pieces, self._bindings, self._at_rest):
            weights = moves.get(piece.node, {}).get(WEIGHTS)
            named = dict(zip(piece.targets, weights)) if weights is not None else self._resting(piece.node, piece.mesh)
            points = positions + sum(named[name] * delta for name, delta in deltas.items() if named[name])
            blend = blended(bound.carriers(scene.world), slice(None), 1.0)
            result[piece.vertices] = turned(blend, points) + blend[:, :, 3]
        return result

    def _deltas(self, piece: Piece) -> dict[str, np.ndarray]:
        """The deltas `(vertex, 3)` of the targets that move a piece, float32, as most files have them."""
        found = ((name, delta.astype(np.float32)) for name, delta in piece.deltas(self.file))
        return {name: delta for name, delta in found if delta.any()}

    def _carrying(self) -> set[int]:
        found = {int(node) for bound in self._bindings for node in bound.nodes[(bound.shares > 0).any(axis=0)]}
        for level in reversed(self.scene.levels):
            found |= {self.scene.parents[node] for node in level.tolist() if node in found}
        return found - {-1}

    def _resting(self, node: int, mesh: int) -> dict[str, float]:
        """The morph weights of a node that nothing moves."""
        if node not in self._weights:
            names = next(list(piece.targets) for piece in self.pieces if piece.node == node)
            self._weights[node] = default_weights(self.file, mesh, self.file.document["nodes"][node], names)
        return self._weights[node]

    def _posed(self, moves: Moves) -> Scene:
        turning, scaling = self.scene.turning.clone(), self.scene.scaling.clone()
        for node, move in moves.items():
            if node not in self.carrying or not move.keys() & LOCAL.keys():
                continue
            own = self.file.document["nodes"][node]
            if "matrix" in own:
                raise InputError(
                    f"{self.file.path}: node '{self.scene.names[node]}' has a matrix and is animated, which glTF forbids: "
                    f"export it again"
                )
            values = {what: np.asarray(move.get(what, own.get(what, rest)), np.float64) for what, rest in LOCAL.items()}
            local = {what: torch.tensor(value) for what, value in values.items()}
            turn = roma.unitquat_to_rotmat(local[ROTATION] / local[ROTATION].norm().clamp_min(1e-9))
            turning[node] = transform_from(turn, local[TRANSLATION])
            scaling[node] = transform_from(torch.diag(local[SCALE]), torch.zeros(3, dtype=torch.float64))
        return replace(self.scene, turning=turning, scaling=scaling)
