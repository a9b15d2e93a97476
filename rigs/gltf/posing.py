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

LOCAL = {TRANSLATION, ROTATION, SCALE}

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
            if node not in self.carrying or not move.keys() & LOCAL:
                continue
            if "matrix" in self.file.document["nodes"][node]:
                self._check_matrix(node)
            turn, scale = turning[node, :, :3], scaling[node, :, :3]
            if ROTATION in move:
                rotation = torch.tensor(np.asarray(move[ROTATION], np.float64))
                turn = roma.unitquat_to_rotmat(rotation / rotation.norm().clamp_min(1e-9))
            if SCALE in move:
                scale = torch.diag(torch.tensor(np.asarray(move[SCALE], np.float64)))
            place = torch.tensor(np.asarray(move[TRANSLATION], np.float64)) if TRANSLATION in move else turning[node, :, 3]
            turning[node] = transform_from(turn, place)
            scaling[node] = transform_from(scale, torch.zeros(3, dtype=torch.float64))
        return replace(self.scene, turning=turning, scaling=scaling)

    def _check_matrix(self, node: int) -> None:
        """Engines take the matrix of an animated node apart, which glTF forbids: a shear or a mirror does not allow it."""
        axes, name = self.scene.turning[node, :, :3], self.scene.names[node]
        if not torch.allclose(axes @ axes.T, torch.eye(3, dtype=torch.float64), atol=1e-3) or torch.linalg.det(axes) < 0:
            raise InputError(
                f"{self.file.path}: node '{name}' is animated and has a matrix that is no rotation with a scale, which glTF "
                f"forbids: export it again"
            )
        self.file.note(
            f"Node '{name}' is animated and has a matrix, which was taken apart into translation, rotation and scale."
        )
