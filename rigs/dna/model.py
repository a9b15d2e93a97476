"""The model of a file at one level of detail: logic, joints and meshes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from rigs.dna.format import DnaFile
from rigs.dna.geometry.meshes import Surface, chosen_meshes, read_surface
from rigs.dna.geometry.skeleton import Skeleton, joint_parents, with_ancestors
from rigs.dna.geometry.skin import Skin
from rigs.dna.geometry.space import Space
from rigs.dna.logic import Logic
from rigs.dna.logic.layout import Layout, Stage


@dataclass(frozen=True)
class Pose:
    """Weights and matrices that determine vertices.

    Attributes:
        channels: weights of the blendshape channels that move the meshes, `(batch, channel)`.
        matrices: skinning matrices of the evaluated joints, `(joint, 3, 4, batch)`.
    """

    channels: Tensor
    matrices: Tensor


class Model(Stage):
    """The meshes of a level of detail and their logic, mm along riginv's axes.

    Args:
        lod: the level of detail.
        meshes: globs of the meshes; empty: all of the level.
        unit_mm: millimetres per unit of length; None: as the file states.
        all_joints: evaluate joints without skin weights, too.

    Attributes:
        space: conversion of coordinates.
        surface: the meshes at rest.
        joints: indices of joints with skin weights and of their ancestors, `(joint,)`.
        channels: indices of the blendshape channels that move vertices, `(channel,)`.

    Raises:
        InputError: the file is damaged, or has no such meshes.
    """

    centre: Tensor
    used_channels: Tensor

    def __init__(
        self, file: DnaFile, lod: int = 0, meshes: Sequence[str] = (), unit_mm: float | None = None, all_joints: bool = False
    ) -> None:
        super().__init__()
        self.layout = layout = Layout.of(file)
        self.space, parents = Space.of(file, unit_mm), joint_parents(file)
        space = self.space
        self.surface: Surface = read_surface(file, layout, space, chosen_meshes(file, layout, lod, meshes))
        weights, deltas = self.surface.weights, self.surface.deltas
        skinned = np.unique(weights.indices[weights.data > 0])
        skinned = np.arange(len(parents)) if all_joints else skinned[skinned < len(parents)]
        self.joints = with_ancestors(parents, skinned)
        self.logic = Logic(file, lod, self.joints)
        driven = self.logic.channel_sources.numpy() < layout.total
        moving = np.bincount(deltas.indices, minlength=deltas.shape[1])[: deltas.shape[1]] > 0
        self.channels = np.flatnonzero(driven & moving)
        centre = (self.surface.rest.max(axis=0) + self.surface.rest.min(axis=0)) / 2
        self.skeleton = Skeleton(file, layout, space, self.joints, centre)
        columns = np.append(self.joints, len(parents))
        self.skin = Skin(self.surface.rest - centre, weights[:, columns], deltas[:, self.channels])
        self.keep(centre=torch.tensor(centre), used_channels=self.channels)

    def pose(self, raw: Tensor) -> Pose:
        """Raw controls `(batch, raw)`, not clamped, to weights and matrices."""
        controls = self.logic.all_controls(raw)
        channels = self.logic.channels_of(controls).index_select(1, self.used_channels)
        if not len(self.joints):
            return Pose(channels, controls.new_zeros(0, 3, 4, len(controls)))
        worlds = self.skeleton.worlds(self.logic.joints, self.logic.joints(controls))
        return Pose(channels, self.skeleton.skinning(worlds))

    def forward(self, raw: Tensor) -> Tensor:
        """Raw controls `(batch, raw)` to vertices `(batch, vertex, 3)`, mm."""
        pose = self.pose(raw)
        return self.skin(pose.channels, pose.matrices) + self.centre.to(raw)


class SomeVertices(nn.Module):
    """A subset of the vertices of a rig.

    Args:
        mapping: from controls to raw controls.
        rows: indices of the vertices, `(row,)`.
    """

    def __init__(self, model: Model, mapping: nn.Module, rows: Tensor) -> None:
        super().__init__()
        self.of_rig = (mapping, model)  # in a tuple: not submodules, they belong to the rig
        self.skin = model.skin.some(rows.cpu().numpy())

    def forward(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to vertices `(batch, row, 3)`, mm."""
        mapping, model = self.of_rig
        pose = model.pose(mapping(controls))
        return self.skin(pose.channels, pose.matrices) + model.centre.to(controls)
