"""Recorded rigs: sampled pairs of controls and vertices, `rig=pairs rig.file=TABLE`."""

from riginv.config.values import PositiveFloat
from riginv.rig.pairs import read_pairs
from riginv.rig.recorded import RecordedRig


class PairsRig(RecordedRig):
    """A table of pairs (`riginv.rig.pairs`), of which a fraction is held out for evaluation.

    Args:
        file: the table: `.npz`, a folder of `.npy` files, or a zarr group.
        held_out: fraction of the poses that is not trained on.
        residual_mm: greatest mean vertex distance of the training poses from the mesh space.

    Raises:
        InputError: the table is missing, damaged, or too small to hold out poses.
    """

    def __init__(self, file: str, held_out: float = 0.1, residual_mm: PositiveFloat = 0.01) -> None:
        super().__init__(f"pairs of {file}", read_pairs(file), held_out, residual_mm)
