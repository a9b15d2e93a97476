"""Making chunks: poses are a function of the seed and the chunk's number, independent of process and order."""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from riginv.config.building import build
from riginv.errors import InputError
from riginv.geometry.blendshapes import apply_deltas
from riginv.rig.batches import generator_at
from riginv.rig.black_box import BlackBoxRig
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.runs.files import write_json
from riginv.sampling.meshes import MeshSampler, select_for_rig
from riginv.sampling.store.layout import COEFFICIENTS, CONTROL_RANGE, CONTROLS, COST, ERRORS, VERTICES, Layout
from riginv.sampling.store.store import PoseStore

BATCH_SIZE = 512
COMPARED = 8  # poses of each chunk for which mesh errors of rounded coefficients are computed


def build_sampler(config: Mapping[str, Any], rig: LinearRig) -> MeshSampler:
    """The sampler of controls.

    Raises:
        InputError: the sampler draws meshes that are no poses of the rig.
    """
    sampler = build(select_for_rig(dict(config), rig), _LazilyMapped(rig))
    sampler.sample_controls(1000, generator_at(0, "trial"))
    return sampler


class _LazilyMapped:
    """A rig in mesh space, computed on demand: most samplers of controls do not need it."""

    def __init__(self, rig: LinearRig) -> None:
        self.rig = rig

    @cached_property
    def mapped(self) -> RigInMeshSpace:
        return RigInMeshSpace(self.rig, MeshSpace.from_rig(self.rig))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.mapped, name)

    def __call__(self, controls: Tensor) -> Tensor:
        return self.mapped(controls)


class ChunkMaker:
    """Makes chunks of a store.

    Args:
        sampler: from `build_sampler`.
    """

    def __init__(self, store: PoseStore, rig: LinearRig, sampler: MeshSampler) -> None:
        self.store, self.rig, self.sampler = store, rig, sampler
        self.neutral = rig.neutral_coefficients()

    @torch.no_grad()
    def make(self, chunk: int) -> None:
        """Evaluate the rig, and write the chunk.

        Raises:
            InputError: NaN or infinite values, values beyond the range of the dtype, or a write error.
        """
        layout, seed = self.store.layout, self.store.facts["seed"]
        controls = self.sampler.sample_controls(layout.count(chunk), generator_at(seed, "sample", chunk)).float()
        values = {CONTROLS: controls.numpy(), CONTROL_RANGE: torch.stack([controls.amin(0), controls.amax(0)])[None].numpy()}
        costs = np.zeros((1, len(ERRORS)), np.float32)
        coefficients, vertices, outside = self._pose(controls, chunk)
        values[COEFFICIENTS] = self._rounded(coefficients, layout, chunk)
        if layout.dtype != "float32":
            costs[0, :4] = self._cost_of_rounding(coefficients, values[COEFFICIENTS])
        if vertices is not None:
            values[VERTICES] = self._rounded(vertices, layout, chunk)
            errors = (torch.from_numpy(values[VERTICES]).float() - vertices).norm(dim=2)
            costs[0, 4:6] = float(errors.max()), float(errors.mean())
        costs[0, 6] = outside
        self.store.write(chunk, {**values, COST: costs})

    def _pose(self, controls: Tensor, chunk: int) -> tuple[Tensor, Tensor | None, float]:
        """Coefficients, vertices where they are stored, and the distance from the span of a fitted basis, mm."""
        coefficients: list[Tensor] = []
        vertices: list[Tensor] = []
        squares = 0.0
        for start in range(0, len(controls), BATCH_SIZE):
            batch = controls[start : start + BATCH_SIZE]
            if isinstance(self.rig, BlackBoxRig):
                posed = self.rig.posed(batch)
                found = self.rig.coefficients_of(posed)
                squares += float((posed - apply_deltas(self.rig.rest_vertices, self.rig.basis, found)).square().sum())
            else:
                found = self.rig.coefficients(batch)
                posed = self.rig(batch) if self.store.layout.vertices else None
            self._check_finite(found if posed is None else torch.cat([found, posed.flatten(1)], dim=1), batch, chunk, start)
            coefficients.append(found)
            if self.store.layout.vertices:
                vertices.append(posed)
        outside = (squares / (len(controls) * len(self.rig.rest_vertices))) ** 0.5
        return torch.cat(coefficients), torch.cat(vertices) if vertices else None, outside

    def _check_finite(self, values: Tensor, controls: Tensor, chunk: int, start: int) -> None:
        broken = (~values.isfinite().all(dim=1)).nonzero()[:, 0]
        if not len(broken):
            return
        row = int(broken[0])
        pose = self.store.layout.rows(chunk).start + start + row
        location = self.store.location.path
        name = f"{location.name if location else self.store.facts['rig']['name']}.pose-{pose}.json"
        file = location.with_name(name) if location else Path(name)
        write_json(file, dict(zip(self.rig.control_names, controls[row].tolist())))
        raise InputError(
            f"rig '{self.rig.name}' gives NaN or infinite values at pose {pose} (chunk {chunk}), whose controls are in {file}: "
            f"repair the rig, or choose another sampler"
        )

    def _rounded(self, values: Tensor, layout: Layout, chunk: int) -> np.ndarray:
        with np.errstate(over="ignore"):
            found = values.numpy().astype(layout.dtype)
        if not np.isfinite(found).all():
            raise InputError(
                f"{self.store}: {layout.dtype} cannot hold {float(values.abs().max()):.4g} in chunk {chunk}: give dtype=float32"
            )
        return found

    def _cost_of_rounding(self, exact: Tensor, rounded: np.ndarray) -> tuple[float, ...]:
        errors = torch.from_numpy(rounded).float() - exact
        mesh_errors = (errors[:COMPARED] @ self.rig.basis.flatten(1)).unflatten(1, self.rig.rest_vertices.shape).norm(dim=2)
        return float(errors.abs().max()), float(errors.abs().mean()), float(mesh_errors.max()), float(mesh_errors.mean())
