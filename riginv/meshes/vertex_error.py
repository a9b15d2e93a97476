"""The metric of vertex errors, in mm (paper, Tables 1 and 2)."""

import torch
from torch import Tensor
from torchmetrics import Metric


class VertexError(Metric):
    """Distances between corresponding vertices, mm. Its state is sums and counts, so the result does not depend on the batches.

    Args:
        of_all_processes: whether several processes each update it with some of the meshes; all must then call `compute`.
    """

    higher_is_better = False
    is_differentiable = False
    full_state_update = False

    total_mm: Tensor
    total_of_max_mm: Tensor
    max_mm: Tensor
    vertices: Tensor
    poses: Tensor

    def __init__(self, of_all_processes: bool = False) -> None:
        super().__init__(sync_on_compute=of_all_processes)
        for name in ("total_mm", "total_of_max_mm", "vertices", "poses"):
            self.add_state(name, torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("max_mm", torch.zeros((), dtype=torch.float64), dist_reduce_fx="max")

    def update(self, found: Tensor, expected: Tensor, known: Tensor | None = None) -> None:
        """Add poses: both `(batch, vertex, 3)`, mm.

        Args:
            known: mask of the vertices to evaluate, `(batch, vertex)`; None: all.
        """
        distances = torch.linalg.vector_norm(found - expected, dim=2).double()
        if known is not None:
            distances = torch.where(known, distances, 0.0)
        greatest = distances.amax(dim=1)
        self.total_mm += distances.sum()
        self.total_of_max_mm += greatest.sum()
        self.max_mm = torch.maximum(self.max_mm, greatest.max())
        self.vertices += distances.numel() if known is None else known.sum()
        self.poses += len(distances)

    def compute(self) -> dict[str, Tensor]:
        """The mean and the maximum over all vertices of all poses, and the mean of the poses' maxima."""
        return {
            "mean_vertex_error_mm": self.total_mm / self.vertices,
            "max_vertex_error_mm": self.max_mm,
            "mean_of_max_vertex_error_mm": self.total_of_max_mm / self.poses,
        }
