"""A rig that exists only as sampled pairs of controls and vertices: `rig=pairs rig.file=TABLE`."""

from riginv.config.values import PositiveFloat
from riginv.rig.pairs import read_pairs
from riginv.rig.recorded import RecordedRig


class PairsRig(RecordedRig):
    """A table of pairs (`riginv.rig.pairs`), a share of which is held out to judge by.

    Args:
        file: the table: `.npz`, a folder of `.npy` files, or a zarr group.
        held_out: the share of poses that training never sees.
        residual_mm: the mean vertex distance that the mesh space may leave of the poses trained on.

    Raises:
        InputError: the table is missing or wrong, or too small to hold anything out.
    """

    def __init__(self, file: str, held_out: float = 0.1, residual_mm: PositiveFloat = 0.01) -> None:
        super().__init__(f"pairs of {file}", read_pairs(file), held_out, residual_mm)
