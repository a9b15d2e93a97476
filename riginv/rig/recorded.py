"""Recorded rigs: tables of poses. They cannot be posed, so models are evaluated on held-out poses."""

from typing import cast

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.batches import PoseBatch, generator_at
from riginv.rig.black_box import fitted_basis
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_sets import StoredMeshes
from riginv.rig.mesh_space import MeshSpace
from riginv.rig.pairs import PairTable

SEED = 20221206
FITTED_TO = 1500  # poses that the basis is fitted to, at most: the decomposition takes time


class RecordedRig(LinearRig):
    """A rig known by a table of pairs alone; only a surrogate of it can be posed.

    Args:
        table: the pairs.
        held_out: the fraction of poses held out for evaluation, a fixed random choice.
        residual_mm: the mean vertex distance that may remain between the training poses and the span of the basis.

    Attributes:
        training_set: the poses to train on.
        held_out: the poses to evaluate on.
        residual_mm: the mean vertex distance that remains.

    Raises:
        InputError: fewer than two poses, or a fraction that leaves none to train on or to evaluate on.
    """

    differentiable = False
    is_fitted = True
    held_out: StoredMeshes

    def __init__(self, name: str, table: PairTable, held_out: float, residual_mm: float) -> None:
        poses = len(table.controls)
        count = round(poses * held_out)
        if not 1 <= count < poses:
            raise InputError(
                f"{name}: held_out={held_out} of {poses} poses leaves {count} to evaluate on; expected 1 to {poses - 1}"
            )
        order = torch.randperm(poses, generator=generator_at(SEED, "held out"))
        evaluate_rows, train_rows = order[:count].sort().values, order[count:].sort().values
        fitted_to = table.vertices[order[count : count + FITTED_TO]]
        basis, self.residual_mm = fitted_basis(table.rest_vertices, fitted_to, residual_mm)
        super().__init__(name, table.described, table.rest_vertices, table.faces, basis)
        self.training_set = StoredMeshes("training", table.vertices[train_rows], controls=table.controls[train_rows])
        self.held_out = StoredMeshes("held_out_pairs", table.vertices[evaluate_rows], controls=table.controls[evaluate_rows])

    def poses_to_train_on(self, space: MeshSpace) -> PoseBatch:
        """The poses to train on, in mesh coordinates."""
        coordinates = torch.cat([space.encode(meshes) for _, meshes in self.training_set.batches()])
        return PoseBatch(coordinates=coordinates, controls=cast(Tensor, self.training_set.controls))

    def coefficients(self, controls: Tensor) -> Tensor:
        raise InputError(
            f"{self.name}: a table of poses cannot be posed: train with rig=pairs rig.file=... model=inverse, then give "
            "bundle=RUN in place of rig=pairs"
        )

    def neutral_coefficients(self) -> Tensor:
        return self.basis.new_zeros(1, len(self.basis))
