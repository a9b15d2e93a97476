"""The logic of a DNA file at one level of detail, in the order of the reference.

GUI table (where GUI controls are given), nets, radial basis functions, pose-space drivers, then joints, channels and maps.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.errors import InputError
from rigs.dna.format import DnaFile
from rigs.dna.format.later_layers import (
    MachineLearning,
    MachineLearningOperations,
    RadialBasis,
    RadialBasisOutputs,
    TwistsAndSwings,
)
from rigs.dna.format.layers import Behavior, Channels, Definition
from rigs.dna.logic.conditions import ConditionTable
from rigs.dna.logic.joint_stage import JointStage
from rigs.dna.logic.joints import JointChanges, group_block, used_columns
from rigs.dna.logic.layout import Layout, Stage, put, quaternion_groups
from rigs.dna.logic.nets import Nets
from rigs.dna.logic.operations import Operations
from rigs.dna.logic.psds import PoseSpaceDrivers
from rigs.dna.logic.radial import EUCLIDEAN, RadialSolvers


class Stages(NamedTuple):
    """Results of all stages for a batch of raw controls.

    Attributes:
        controls: all controls, `(batch, control)`.
        joints: changes of joints.
        channels: weights of the blendshape channels, `(batch, channel)`.
        maps: animated maps, `(batch, map)`.
    """

    controls: Tensor
    joints: JointChanges
    channels: Tensor
    maps: Tensor


class Logic(Stage):
    """The logic of a file at a level of detail.

    Args:
        joints: indices of the joints to evaluate, `(joint,)`; None: all.

    Attributes:
        layout: layout of the controls.
        quaternions: raw controls that hold quaternions, `(group, 4)` as x y z w.

    Raises:
        InputError: the file lacks a layer, or something in it is damaged or cannot be evaluated.
    """

    channel_inputs: Tensor
    channel_sources: Tensor

    def __init__(self, file: DnaFile, lod: int = 0, joints: np.ndarray | None = None) -> None:
        super().__init__()
        definition, behavior = file.need(Definition), file.need(Behavior)
        self.layout = layout = Layout.of(file)
        if not 0 <= lod < max(layout.lod_count, 1):
            raise InputError(
                f"{file.path}: rig.lod={lod}, expected 0 to {max(layout.lod_count, 1) - 1}, the levels of the file"
            )
        table = behavior.controls.table
        self.table = ConditionTable(layout, "the GUI table", table, len(table.inputs), layout.gui, layout.raw)
        learned, operations = file.find(MachineLearning), file.find(MachineLearningOperations)
        radial, outputs = file.find(RadialBasis), file.find(RadialBasisOutputs)
        self.learned: Operations | Nets | None = None
        if operations is not None and operations.types:
            self.learned = Operations(layout, learned, operations, lod)
        elif learned is not None:
            self.learned = Nets(layout, learned, lod)
        self.radial = RadialSolvers(layout, radial, outputs, lod) if radial is not None else None
        maps = behavior.maps
        map_rows = layout.of_lod("the table of animated maps", maps.counts, lod, len(maps.table.inputs))
        self.maps = ConditionTable(
            layout, "the table of animated maps", maps.table, map_rows, layout.total, len(definition.maps)
        )
        self._keep_channels(behavior.channels, lod, len(definition.channels))
        joints = np.arange(len(definition.joints)) if joints is None else joints
        self.joints = JointStage(file, layout, lod, joints)
        used = np.zeros(layout.total, bool)
        for number in range(len(behavior.joints.groups)):
            used[used_columns(group_block(file, layout, number, lod))] = True
        used[self.channel_inputs.numpy()] = True
        used[maps.table.inputs[:map_rows]] = True
        if operations is not None:
            used[operations.inputs] = True
        self.psds = PoseSpaceDrivers(layout, behavior.controls.psds, used[layout.psds])
        self.quaternions = quaternion_groups(_groups(radial, file.find(TwistsAndSwings)))
        if (self.quaternions >= layout.raw).any():
            self.quaternions = self.quaternions[(self.quaternions < layout.raw).all(axis=1)]

    def _keep_channels(self, channels: Channels, lod: int, count: int) -> None:
        layout = self.layout
        layout.check_lengths("the blendshape channels", inputs=len(channels.inputs), outputs=len(channels.outputs))
        layout.check_controls("the input of a blendshape channel", channels.inputs)
        layout.check("the output of a blendshape channel", channels.outputs, count, "channels")
        used = layout.of_lod("the blendshape channels", channels.counts, lod, len(channels.inputs))
        source = np.full(count, layout.total)  # index of a 0 after the last control
        source[channels.outputs[:used]] = channels.inputs[:used]
        self.keep(channel_inputs=channels.inputs[:used].astype(int), channel_sources=source)

    def raw_of(self, gui: Tensor) -> Tensor:
        """GUI controls `(batch, gui)` to raw controls `(batch, raw)`; those without rows are 0, also quaternions."""
        return self.table(gui)

    def all_controls(self, raw: Tensor, psds_before: Tensor | None = None) -> Tensor:
        """Raw controls `(batch, raw)` to all controls `(batch, control)`.

        Args:
            psds_before: PSDs of the previous evaluation, `(batch, psd)`, for PSDs that depend on PSDs; None: all 0.
        """
        layout = self.layout
        psds = raw.new_zeros(len(raw), layout.psd) if psds_before is None else psds_before
        controls = torch.cat([raw, psds, raw.new_zeros(len(raw), layout.ml + layout.rbf)], dim=1)
        if self.learned is not None:
            controls = self.learned(controls)
        if self.radial is not None:
            controls = self.radial(controls)
        if not layout.psd:
            return controls
        positions = torch.arange(layout.psds.start, layout.psds.stop, device=raw.device)
        return put(controls, positions, self.psds(controls))

    def channels_of(self, controls: Tensor) -> Tensor:
        """All controls `(batch, control)` to the weights of blendshape channels `(batch, channel)`."""
        padded = torch.cat([controls, controls.new_zeros(len(controls), 1)], dim=1)
        return padded.index_select(1, self.channel_sources)

    def forward(self, raw: Tensor) -> Stages:
        """Raw controls `(batch, raw)`, not clamped, to every stage."""
        controls = self.all_controls(raw)
        return Stages(controls, self.joints(controls), self.channels_of(controls), self.maps(controls))


def _groups(radial: RadialBasis | None, twists: TwistsAndSwings | None) -> list[np.ndarray]:
    """Controls of all quaternions, in groups of four."""
    solvers = radial.solvers if radial is not None else ()
    found = [group for one in solvers if one.distance != EUCLIDEAN for group in one.controls.reshape(-1, 4)]
    entries = (*twists.twists, *twists.swings) if twists is not None else ()
    return found + [entry.controls for entry in entries]
