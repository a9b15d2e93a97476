"""Clusters of vertices that move together, and the controls that move them."""

from typing import NamedTuple

import numpy as np
import torch
from scipy.cluster.vq import kmeans2
from torch import Tensor

from riginv.methods.baselines.measured import pose_coordinates
from riginv.methods.baselines.sides import Sides
from riginv.rig.mesh_space import RigInMeshSpace

ITERATIONS = 50  # of k-means


class Cluster(NamedTuple):
    """Vertices and controls that belong together.

    Attributes:
        vertices: indices.
        controls: indices; a control may belong to several clusters.
        strength: how far each of these controls moves the vertices on average, mm.
    """

    vertices: Tensor
    controls: Tensor
    strength: Tensor


def control_reach(rig: RigInMeshSpace) -> Tensor:
    """The largest displacement of each vertex by each control alone, mm, `(vertex, control)`."""
    sides = Sides(rig.source)
    reach = torch.zeros(rig.space.vertex_count, len(rig.source.controls))
    for side, weights in enumerate(torch.eye(len(sides), dtype=torch.float64)):
        moved = rig.space.decode(pose_coordinates(rig, sides, weights[None]).to(rig.linear_map))[0] - rig.space.rest_vertices
        control = int(sides.control[side])
        reach[:, control] = torch.maximum(reach[:, control], moved.norm(dim=1).to(reach))
    return reach


def find_clusters(reach: Tensor, count: int, seed: int) -> list[Cluster]:
    """K-means over the vertices by which controls reach them; each cluster takes the controls that reach it much.

    In each cluster the controls are split in two by their mean reach, by k-means too, and the upper part belongs to it. A
    control that no cluster took goes to the one that it reaches most; one that moves nothing belongs to none.

    Args:
        reach: `(vertex, control)`, as from `control_reach`.
        count: of clusters, at most; those that nothing reaches are left out.
        seed: of k-means.
    """
    data = reach.double().numpy()
    count = min(count, len(np.unique(data, axis=0)))
    _, labels = kmeans2(data, count, iter=ITERATIONS, minit="++", rng=np.random.default_rng(seed))
    means = np.stack([data[labels == label].mean(axis=0) for label in np.unique(labels)])
    members = np.stack([mean > _threshold(mean) for mean in means]) & (means > 0)
    for control in np.nonzero(~members.any(axis=0) & (means.max(axis=0) > 0))[0]:
        members[means[:, control].argmax(), control] = True
    clusters = []
    for label, mean, member in zip(np.unique(labels), means, members):
        if member.any():
            vertices, controls = np.nonzero(labels == label)[0], np.nonzero(member)[0]
            clusters.append(Cluster(*map(torch.from_numpy, (vertices, controls, mean[controls]))))
    return clusters


def _threshold(values: np.ndarray) -> float:
    """Half-way between the means of the small and the large values: k-means with two clusters in one dimension, exactly."""
    ordered = np.sort(values)
    sizes = np.arange(1, len(ordered))
    below = np.cumsum(ordered)[:-1]
    low, high = below / sizes, (ordered.sum() - below) / (len(ordered) - sizes)
    between = sizes * (len(ordered) - sizes) * (high - low) ** 2
    best = int(between.argmax()) if len(between) else 0
    return float(low[best] + high[best]) / 2 if len(between) and between[best] > 0 else -np.inf
