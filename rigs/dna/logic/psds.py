"""Pose-space drivers: products of controls, for corrective shapes."""

import numpy as np
import torch
from torch import Tensor

from riginv.geometry.blendshapes import combination_weights
from rigs.dna.format.layers import Psds
from rigs.dna.logic.layout import Layout, Stage


class PoseSpaceDrivers(Stage):
    """Each is min(1, the product of its factors and of its controls, each clamped to [0, 1]).

    Controls are clamped first, and all drivers are 0 until computed: a driver that another one depends on counts as 0, as in
    the first evaluation of the reference.

    Args:
        used: mask of the drivers that are used, `(driver,)`; the others are 0.

    Raises:
        InputError: a row lies outside the drivers, or a column outside the controls.
    """

    members: Tensor
    factors: Tensor

    def __init__(self, layout: Layout, psds: Psds, used: np.ndarray) -> None:
        super().__init__()
        layout.check_lengths("the PSD matrix", rows=len(psds.rows), columns=len(psds.columns), values=len(psds.values))
        layout.check_controls("a column of the PSD matrix", psds.columns)
        layout.check_finite("the PSD matrix", psds.values)
        rows = psds.rows.astype(np.int64) - layout.raw
        outside = (rows < 0) | (rows >= layout.psd)
        if outside.any():
            raise layout.wrong(
                f"a row of the PSD matrix is control {int(psds.rows[np.argmax(outside)])}, its {layout.psd} PSDs are controls "
                f"{layout.raw} to {layout.raw + layout.psd - 1}"
            )
        order = np.argsort(rows, kind="stable")
        counts = np.bincount(rows, minlength=layout.psd)
        layout.check_room("the PSD matrix", layout.psd, int(counts.max(initial=1)))
        members = np.full((layout.psd, int(counts.max(initial=1))), -1)
        slot = np.arange(len(rows)) - (np.cumsum(counts) - counts)[rows[order]]
        members[rows[order], slot] = psds.columns[order]
        factors = np.ones(layout.psd)
        np.multiply.at(factors, rows, psds.values.astype(np.float64))
        factors[(counts == 0) | ~used] = 0.0
        self.keep(members=members, factors=factors)
        self.chained = bool(((psds.columns >= layout.psds.start) & (psds.columns < layout.psds.stop)).any())

    def forward(self, controls: Tensor) -> Tensor:
        """All controls `(batch, control)` to the drivers `(batch, driver)`."""
        products = combination_weights(controls.clamp(0, 1), self.members)
        return torch.clamp(products * self.factors.to(controls), max=1.0)
