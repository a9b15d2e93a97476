"""The scene graph: nodes with their local and world transforms at rest."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import roma
import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.geometry.kinematics import compose, forward_kinematics, transform_from, tree_levels
from rigs.gltf.container import GltfFile

UNIT_LENGTH = 1e-2  # tolerance of the length of quaternions
SHEAR = 1e-4  # greatest cosine between the axes of a matrix without shear


@dataclass(frozen=True)
class Scene:
    """The nodes of a file.

    Attributes:
        names: unique names of the nodes; unnamed and repeated ones get their index.
        parents: index of each node's parent, -1 for a root.
        shown: whether each node is in the file's scene; all where there are no scenes.
        rigid: `(node, 3, 4)`: translation and rotation of the local transform, metres.
        scaling: `(node, 3, 4)`: the rest of the local transform, which is applied first: local = rigid scaling.
        levels: node indices by depth.
    """

    names: list[str]
    parents: list[int]
    shown: list[bool]
    rigid: Tensor
    scaling: Tensor
    levels: list[Tensor]

    @cached_property
    def world(self) -> Tensor:
        """World transforms at rest, `(node, 3, 4)`, metres."""
        return forward_kinematics(compose(self.rigid, self.scaling)[None], self.parents)[0]


def read_scene(file: GltfFile) -> Scene:
    """Read the scene graph.

    Raises:
        InputError: a node has two parents, is its own ancestor, or has an invalid transform; the message names the node.
    """
    nodes = file.document.get("nodes", [])
    if not nodes:
        raise InputError(f"{file.path}: no nodes: there is nothing to show; export the avatar again")
    names = _unique_names(nodes)
    parents = _parents(file, nodes, names)
    try:
        levels = tree_levels(parents, names)
    except InputError as error:
        raise InputError(f"{file.path}: {error}") from None
    parts = [_transform(file, node, name) for node, name in zip(nodes, names)]
    rigid, scaling = (torch.stack(part) for part in zip(*parts))
    return Scene(names, parents, _shown(file, parents, levels), rigid, scaling, levels)


def _unique_names(nodes: list[dict[str, Any]]) -> list[str]:
    names: list[str] = []
    taken: set[str] = set()
    for number, node in enumerate(nodes):
        name = node.get("name") or f"node_{number}"
        name = f"{name}_{number}" if name in taken else name
        taken.add(name)
        names.append(name)
    return names


def _parents(file: GltfFile, nodes: list[dict[str, Any]], names: list[str]) -> list[int]:
    parents = [-1] * len(nodes)
    for number, node in enumerate(nodes):
        for child in node.get("children", []):
            file.item("nodes", child, f"node '{names[number]}'")
            if parents[child] != -1:
                raise InputError(
                    f"{file.path}: node '{names[child]}' is a child of '{names[parents[child]]}' and of '{names[number]}', "
                    f"expected one parent: export it again"
                )
            parents[child] = number
    return parents


def _shown(file: GltfFile, parents: list[int], levels: list[Tensor]) -> list[bool]:
    if not file.document.get("scenes"):
        return [True] * len(parents)
    scene = file.item("scenes", file.document.get("scene", 0), "the document's scene")
    shown = [False] * len(parents)
    for root in scene.get("nodes", []):
        file.item("nodes", root, "the scene")
        shown[root] = True
    for level in levels[1:]:
        for node in level.tolist():
            shown[node] = shown[node] or shown[parents[node]]
    return shown


def _transform(file: GltfFile, node: dict[str, Any], name: str) -> tuple[Tensor, Tensor]:
    """`rigid` and `scaling` of one node, as in `Scene`; float64."""
    zero = torch.zeros(3, dtype=torch.float64)
    if "matrix" in node:
        columns = _vector(file, node, "matrix", 16, name).reshape(4, 4)
        if not torch.allclose(columns[:, 3], torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64), atol=1e-5):
            raise InputError(f"{file.path}: the matrix of node '{name}' does not end in the row 0 0 0 1: export it again")
        linear, translation = columns[:3, :3].T, columns[3, :3]
        scale = linear.norm(dim=0)
        axes = linear / scale.clamp_min(1e-12)
        if (axes.T @ axes - torch.eye(3, dtype=torch.float64)).abs().max() > SHEAR:
            axes, scale = linear, torch.ones_like(scale)  # sheared: a joint rotates before all of its matrix
        return transform_from(axes, translation), transform_from(torch.diag(scale), zero)
    rotation = _vector(file, node, "rotation", 4, name, (0.0, 0.0, 0.0, 1.0))
    if abs(float(rotation.norm()) - 1) > UNIT_LENGTH:
        raise InputError(
            f"{file.path}: the rotation of node '{name}' is a quaternion of length {float(rotation.norm()):.3g}, expected 1: "
            f"export it again"
        )
    matrix = roma.unitquat_to_rotmat(rotation / rotation.norm())
    scale = torch.diag(_vector(file, node, "scale", 3, name, (1.0, 1.0, 1.0)))
    return transform_from(matrix, _vector(file, node, "translation", 3, name, (0.0, 0.0, 0.0))), transform_from(scale, zero)


def _vector(
    file: GltfFile, node: dict[str, Any], field: str, length: int, name: str, default: tuple[float, ...] = ()
) -> Tensor:
    values = node.get(field, default)
    if len(values) != length:
        raise InputError(f"{file.path}: the {field} of node '{name}' has {len(values)} numbers, expected {length}")
    return torch.tensor(values, dtype=torch.float64)
