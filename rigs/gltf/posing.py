"""Meshes in the poses of an animation."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import roma
import torch

from riginv.errors import InputError
from rigs.gltf.animation import ROTATION, SCALE, TRANSLATION, WEIGHTS, Channel
from rigs.gltf.avatar import blend_transforms, transform_vectors
from rigs.gltf.container import GltfFile
from rigs.gltf.scene import Scene
from rigs.gltf.submeshes import Submesh, read_submeshes
from rigs.gltf.targets import default_weights

LOCAL = {TRANSLATION, ROTATION, SCALE}

Pose = Mapping[int, Mapping[str, np.ndarray]]  # values by node and path


def poses_at(channels: Sequence[Channel], times: np.ndarray) -> Sequence[Pose]:
    """Poses that channels give at times `(time,)`."""
    found: list[dict[int, dict[str, np.ndarray]]] = [{} for _ in times]
    for channel in channels:
        for pose, values in zip(found, channel.at(times)):
            pose.setdefault(channel.node, {})[channel.path] = values
    return found


class PosedMeshes:
    """Meshes of a file that can be posed.

    Args:
        nodes: nodes of the meshes, in the order of the vertices.

    Attributes:
        submeshes: in the order of the file's vertices.
        vertex_count: of all submeshes.
        moving: nodes that move vertices, directly or through nodes below them.
        morphing: nodes whose morph weights move vertices.
    """

    def __init__(self, file: GltfFile, scene: Scene, nodes: list[int]) -> None:
        self.file, self.scene = file, scene
        self.submeshes = read_submeshes(file, nodes)
        self.vertex_count = sum(submesh.count for submesh in self.submeshes)
        self._bindings = [submesh.binding(file, scene) for submesh in self.submeshes]
        self._at_rest = [(submesh.positions(file), self._deltas(submesh)) for submesh in self.submeshes]
        self._weights: dict[int, dict[str, float]] = {}
        self.moving = self._moving()
        self.morphing = {submesh.node for submesh, (_, deltas) in zip(self.submeshes, self._at_rest) if deltas}

    def faces(self) -> np.ndarray:
        """Triangles `(face, 3)`."""
        return np.concatenate([submesh.start + submesh.triangles(self.file) for submesh in self.submeshes])

    def follows(self, channel: Channel) -> bool:
        """Whether a channel affects any vertex."""
        return channel.node in (self.morphing if channel.path == WEIGHTS else self.moving)

    def vertices(self, pose: Pose) -> np.ndarray:
        """Vertices `(vertex, 3)` in world space, metres; nodes that are not in the pose are at rest."""
        scene = self._posed(pose)
        result = np.empty((self.vertex_count, 3))
        for submesh, bound, (positions, deltas) in zip(self.submeshes, self._bindings, self._at_rest):
            weights = pose.get(submesh.node, {}).get(WEIGHTS)
            named = dict(zip(submesh.targets, weights)) if weights is not None else self._resting(submesh.node, submesh.mesh)
            points = positions + sum(named[name] * delta for name, delta in deltas.items() if named[name])
            blend = blend_transforms(bound.posed(scene.world), slice(None), 1.0)
            result[submesh.vertices] = transform_vectors(blend, points) + blend[:, :, 3]
        return result

    def _deltas(self, submesh: Submesh) -> dict[str, np.ndarray]:
        """Deltas `(vertex, 3)` float32 of the targets that move a submesh."""
        found = ((name, delta.astype(np.float32)) for name, delta in submesh.deltas(self.file))
        return {name: delta for name, delta in found if delta.any()}

    def _moving(self) -> set[int]:
        found = {int(node) for bound in self._bindings for node in bound.nodes[(bound.weights > 0).any(axis=0)]}
        for level in reversed(self.scene.levels):
            found |= {self.scene.parents[node] for node in level.tolist() if node in found}
        return found - {-1}

    def _resting(self, node: int, mesh: int) -> dict[str, float]:
        """Rest values of the morph weights of a node."""
        if node not in self._weights:
            names = next(list(submesh.targets) for submesh in self.submeshes if submesh.node == node)
            self._weights[node] = default_weights(self.file, mesh, self.file.document["nodes"][node], names)
        return self._weights[node]

    def _posed(self, pose: Pose) -> Scene:
        return posed_scene(self.file, self.scene, {node: values for node, values in pose.items() if node in self.moving})


def posed_scene(file: GltfFile, scene: Scene, pose: Pose) -> Scene:
    """A scene whose nodes have the transforms of a pose.

    Raises:
        InputError: a node has a matrix that cannot be decomposed.
    """
    rigid, scaling = scene.rigid.clone(), scene.scaling.clone()
    moved = {node: values for node, values in pose.items() if values.keys() & LOCAL}
    for node in moved:
        if "matrix" in file.document["nodes"][node]:
            _check_matrix(file, scene, node)

    def values_of(path: str) -> tuple[list[int], torch.Tensor]:
        found = {node: values[path] for node, values in moved.items() if path in values}
        return list(found), torch.tensor(np.array(list(found.values()), np.float64))

    nodes, quaternions = values_of(ROTATION)
    if nodes:
        lengths = quaternions.norm(dim=1, keepdim=True).clamp_min(1e-9)
        rigid[nodes, :, :3] = roma.unitquat_to_rotmat(quaternions / lengths)
    nodes, translations = values_of(TRANSLATION)
    if nodes:
        rigid[nodes, :, 3] = translations
    nodes, scales = values_of(SCALE)
    if nodes:
        scaling[nodes, :, :3] = torch.diag_embed(scales)
        scaling[nodes, :, 3] = 0.0
    return replace(scene, rigid=rigid, scaling=scaling)


def _check_matrix(file: GltfFile, scene: Scene, node: int) -> None:
    """Raises InputError where the matrix of an animated node, which glTF forbids, cannot be decomposed as engines do."""
    axes, name = scene.rigid[node, :, :3], scene.names[node]
    if not torch.allclose(axes @ axes.T, torch.eye(3, dtype=torch.float64), atol=1e-3) or torch.linalg.det(axes) < 0:
        raise InputError(
            f"{file.path}: node '{name}' is animated and has a matrix that is no rotation with a scale, which glTF "
            f"forbids: export it again"
        )
    file.note(f"Node '{name}' is animated and has a matrix, which was taken apart into translation, rotation and scale.")
