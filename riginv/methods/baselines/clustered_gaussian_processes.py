"""Rackovic et al.: a Gaussian process for each cluster of vertices and the controls that move them."""

import torch
from torch import Tensor

from riginv.config.values import PositiveFloat, PositiveInt
from riginv.geometry.neighbours import spread_points
from riginv.methods.base import BatchedMethod
from riginv.methods.baselines.clusters import Cluster, control_reach, find_clusters
from riginv.methods.baselines.gaussian_process import GaussianProcess, PrincipalComponents, as_controls, training_poses
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.sampling.meshes import MeshSampler


class ClusteredGaussianProcesses(BatchedMethod):
    """Cluster the vertices, give each cluster its controls, and regress these on the cluster's vertices alone.

    Args:
        sampler: the poses that it learns from; they must come with their controls.
        clusters: of vertices, at most.
        drawn: poses that are drawn.
        poses: how many of these each cluster keeps, as far apart on its vertices as can be.
        variance: the fraction of the variance of a cluster's vertices that its components keep.
    """

    batch_size = 1024
    source = (
        "Rackovic, Soares, Jakovetic, Desnica, Ljubobratovic: Clustering of the blendshape facial model (EUSIPCO 2021, "
        "arXiv 2110.15313): two-fold clustering, then one Gaussian process for each cluster. Changed: clusters come from "
        "what each control of the rig does at full, where theirs come of the blendshapes, so that any rig has them; a "
        "control of several clusters takes their mean, weighted by how much it moves each (our choice); the process is "
        "that of our Holden baseline; what of a mesh lies outside the rig's mesh space is dropped."
    )

    def __init__(
        self,
        rig: RigInMeshSpace,
        sampler: MeshSampler,
        clusters: PositiveInt = 12,
        drawn: PositiveInt = 10_000,
        poses: PositiveInt = 800,
        variance: PositiveFloat = 0.999,
    ) -> None:
        super().__init__(rig)
        self.sampler, self.clusters, self.drawn, self.poses, self.variance = sampler, clusters, drawn, poses, variance

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        coordinates, away = training_poses(self.rig, self.sampler, self.drawn, seed)
        self.parts = []
        for cluster in find_clusters(control_reach(self.rig), self.clusters, seed):
            components = PrincipalComponents(coordinates, self.variance, self._view(cluster))
            inputs = components(coordinates)
            kept = spread_points(inputs, self.poses)
            process = GaussianProcess(inputs[kept], away[kept][:, cluster.controls])
            self.parts.append((cluster, components, process))

    def _view(self, cluster: Cluster) -> Tensor:
        """A map `(coordinate, coordinate)` after which distances are those of the cluster's vertices."""
        frame = self.rig.space.directions[:, cluster.vertices].flatten(1).double()
        squares, directions = torch.linalg.eigh(frame @ frame.T)
        return directions * squares.clamp_min(0).sqrt()

    def solve(self, coordinates: Tensor) -> Tensor:
        away = coordinates.new_zeros(len(coordinates), len(self.rig.source.controls), dtype=torch.float64)
        total = torch.zeros(away.shape[1], dtype=torch.float64)
        for cluster, components, process in self.parts:
            away[:, cluster.controls] += process(components(coordinates)) * cluster.strength
            total[cluster.controls] += cluster.strength
        return as_controls(self.rig, away / torch.where(total > 0, total, 1.0))
