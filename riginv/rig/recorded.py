"""A rig that is known only by recorded poses: it cannot be posed, so poses held out from training judge in its place."""

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
FITTED_TO = 1500  # poses: as many as a decomposition is quick for; the others are encoded all the same


class RecordedRig(LinearRig):
    """A rig known by a table of pairs alone. A surrogate of it can be posed; it cannot.

    Args:
        table: the pairs.
        held_out: the share of poses that training never sees, chosen at random but always the same.
        residual_mm: the mean vertex distance that the basis may leave of the poses trained on.

    Attributes:
        training: the poses to train on.
        held_out: the poses that judge.
        residual_mm: the mean vertex distance that the basis did leave.

    Raises:
        InputError: fewer than two poses, or a share that leaves nothing to train on or to judge by.
    """

    differentiable = False
    is_fitted = True
    held_out: StoredMeshes

    def __init__(self, name: str, table: PairTable, held_out: float, residual_mm: float) -> None:
        poses = len(table.controls)
        judging = round(poses * held_out)
        if not 1 <= judging < poses:
            raise InputError(
                f"{name}: held_out={held_out} of {poses} poses leaves {judging} to judge by; expected 1 to {poses - 1}"
            )
        order = torch.randperm(poses, generator=generator_at(SEED, "held out"))
        evaluate_rows, train_rows = order[:judging].sort().values, order[judging:].sort().values
        fitted_to = table.vertices[order[judging : judging + FITTED_TO]]
        basis, self.residual_mm = fitted_basis(table.rest_vertices, fitted_to, residual_mm)
        super().__init__(name, table.described, table.rest_vertices, table.faces, basis)
        self.training = StoredMeshes("training", table.vertices[train_rows], controls=table.controls[train_rows])
        self.held_out = StoredMeshes("held_out_pairs", table.vertices[evaluate_rows], controls=table.controls[evaluate_rows])

    def poses_to_train_on(self, space: MeshSpace) -> PoseBatch:
        """The poses to train on, in mesh coordinates."""
        pieces = [space.encode(piece) for _, piece in self.training.batches()]
        return PoseBatch(coordinates=torch.cat(pieces), controls=self.training.controls)

    def coefficients(self, controls: Tensor) -> Tensor:
        raise InputError(f"{self.name}: recorded poses cannot be posed anew: train a surrogate of them with model=forward")

    def neutral_coefficients(self) -> Tensor:
        return self.basis.new_zeros(1, len(self.basis))
