"""DNA files as rigs."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.geometry.kinematics import Skeleton
from riginv.rig.arkit import ArkitParts, arkit_deltas, arkit_parts
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.jacobian import Jacobian, forward_jacobian
from riginv.rig.size import extent
from rigs.dna.control_sets import Kind, control_set
from rigs.dna.format import DnaFile, read_dna
from rigs.dna.format.layers import Definition
from rigs.dna.linear import Coefficients, LinearMap, linear_map, skin_features
from rigs.dna.model import Model, SomeVertices
from rigs.dna.primaries import primaries_first
from rigs.dna.skeletons import skeleton_of

LOG = logging.getLogger(__name__)
PICTURED = 24  # most controls shown as expressions
SAME_MM = 1e-2  # distance of the rest mesh from the file's neutral mesh that is not reported


class DnaRig(RigBackend):
    """A character from a DNA file: its GUI or raw controls, and the meshes of one level of detail.

    With few or no moving joints the rig is a `LinearDnaRig`.

    Args:
        file: the file, of any version from 2.1 to 2.8.
        controls: `gui`: animators' controls; `raw`: inputs of the logic; None: `gui` where the file has them.
        lod: level of detail, 0 for the finest.
        meshes: globs of the meshes of the rig; empty: all of the level.
        unit_mm: millimetres per unit of length; None: as the file states.

    Attributes:
        parts: name of each mesh, its first vertex and one past its last.
        model: map from raw controls to vertices.
        joint_names: of all joints of the file.

    Raises:
        InputError: the file cannot be read or contains no rig.
    """

    poses_subsets = True

    def __init__(
        self,
        file: str,
        controls: Kind | None = None,
        lod: int = 0,
        meshes: Sequence[str] = (),
        unit_mm: float | None = None,
    ) -> None:
        _check_arguments(controls, lod, meshes, unit_mm)
        content = read_dna(file)
        model = Model(content, lod, list(meshes), unit_mm)
        chosen = control_set(content, model.logic, controls)
        neutral = torch.tensor([[control.neutral for control in chosen.controls]], dtype=torch.float64)
        with torch.no_grad():
            raw = chosen.mapping(neutral)
            rest = model(raw)[0]
        name, faces = Path(file).stem, torch.tensor(model.surface.triangles.copy())
        ends_in = linear_map(model, list(content.need(Definition).channels))
        if ends_in is None:
            super().__init__(name, chosen.controls, rest.float(), faces)
        else:
            self.__class__ = LinearDnaRig  # known only once the file has been read
            ends_in, primaries = primaries_first(ends_in, model, chosen)
            LinearRig.__init__(
                cast(LinearRig, self), name, chosen.controls, rest.float(), faces, ends_in.basis, ends_in.names, primaries
            )
            self.ends_in = ends_in.stage
        self.model, self.mapping = model, chosen.mapping
        self.skin_features = None
        if ends_in is not None and not ends_in.channels:
            self.skin_features = skin_features(model, cast(Coefficients, ends_in.stage))
        self.joint_names = content.need(Definition).joints
        self._moved_at_rest = float(np.abs(rest.numpy() - model.surface.rest).max(initial=0.0))
        starts = model.surface.starts.tolist()
        self.parts = tuple(zip(model.surface.names, starts, starts[1:]))
        LOG.info("\n  ".join([self._describe(content, lod), *chosen.notes, *self._remarks(ends_in)]))

    def forward(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to vertices `(batch, vertex, 3)`, mm."""
        return self.model(self.mapping(controls))

    def raw_controls(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` of this rig to the file's raw controls `(batch, raw)`."""
        return self.mapping(controls)

    def vertex_subset(self, rows: Tensor) -> nn.Module:
        return SomeVertices(self.model, self.mapping, rows)

    def skeleton(self) -> Skeleton | None:
        if self._moved_at_rest > SAME_MM:
            return None
        return skeleton_of(self.model, self.mapping, self.joint_names)

    def expressions(self) -> dict[str, dict[str, float]]:
        """Single controls at their upper limits, evenly selected."""
        step = max(1, -(-len(self.controls) // PICTURED))
        return {control.name: {control.name: control.upper} for control in self.controls[::step]}

    def _describe(self, content: DnaFile, lod: int) -> str:
        size = extent((self.rest_vertices.amax(0) - self.rest_vertices.amin(0)).tolist())
        layout = self.model.layout
        return (
            f"{self.name}: DNA 2.{content.version}, level of detail {lod} of {layout.lod_count}: {len(self.controls)} "
            f"controls, {len(self.model.joints)} joints, {len(self.model.channels)} blendshape channels, {len(self.parts)} "
            f"meshes, {len(self.rest_vertices):,} vertices, {size}"
        )

    def _remarks(self, ends_in: LinearMap | None) -> list[str]:
        """Notes for the user."""
        remarks = []
        away = self._moved_at_rest
        if away > SAME_MM:
            remarks.append(f"with its controls at rest the logic moves vertices by up to {away:.3g} mm; that is the rest mesh")
        if self.model.logic.psds.chained:
            remarks.append("some PSDs depend on PSDs, which count as 0, as when an engine evaluates a file for the first time")
        if ends_in is None:
            remarks.append("too many joints for an exact basis: one is fitted to random poses (mesh_space.residual_mm)")
        return remarks


class LinearDnaRig(DnaRig, LinearRig):
    """A DNA rig whose vertices are a linear map of a moderate number of coefficients."""

    def coefficients(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to the coefficients of `rigs.dna.linear`."""
        return self.ends_in(self.model.pose(self.mapping(controls)))

    @torch.no_grad()
    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        return forward_jacobian(self.coefficients, controls)

    def features(self, coefficients: Tensor) -> Tensor | None:
        return None if self.skin_features is None else self.skin_features(coefficients)

    def feature_change(self, before: Tensor, after: Tensor) -> Tensor:
        return after - before if self.skin_features is None else self.skin_features.change(before, after)

    def forward(self, controls: Tensor) -> Tensor:
        return LinearRig.forward(self, controls)

    def arkit_parts(self) -> dict[str, ArkitParts]:
        return arkit_parts(self._primary_names)

    def arkit_deltas(self) -> dict[str, Tensor]:
        return arkit_deltas(self.arkit_parts(), dict(zip(self._primary_names, self.basis)))

    @property
    def _primary_names(self) -> list[str]:
        return list(self.coefficient_names[: self.primary_count]) if self.has_blendshapes else []


def _check_arguments(controls: str | None, lod: int, meshes: Sequence[str], unit_mm: float | None) -> None:
    if controls not in ("gui", "raw", None):
        raise InputError(f"rig.controls is {controls!r}, expected gui, raw or null")
    if isinstance(lod, bool) or not isinstance(lod, int) or lod < 0:
        raise InputError(f"rig.lod is {lod!r}, expected a whole number of at least 0")
    if isinstance(meshes, str) or not all(isinstance(glob, str) for glob in meshes):
        raise InputError(f"rig.meshes is {meshes!r}, expected a list of globs: rig.meshes=['head*']")
    if unit_mm is not None and (isinstance(unit_mm, bool) or not isinstance(unit_mm, int | float) or not 0 < unit_mm < 1e6):
        raise InputError(f"rig.unit_mm is {unit_mm!r}, expected a number above 0, or null for what the file states")
