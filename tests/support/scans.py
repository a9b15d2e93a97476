"""Scans of small rigs: their own surface with other vertices."""

import numpy as np
import torch
import trimesh
from torch import Tensor

from riginv.rig.interface import LinearRig
from riginv.tracking.surfaces.triangles import TriangleMesh


@torch.no_grad()
def posed_mesh(rig: LinearRig, controls: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a pose."""
    return rig(controls[None])[0].double().numpy(), rig.faces.numpy()


def resampled(rig: LinearRig, controls: Tensor, seed: int = 0) -> TriangleMesh:
    """The surface of a pose, exactly, with random points of its triangles as further vertices, in another order."""
    points, faces = posed_mesh(rig, controls)
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(3) * 3, len(faces))
    centres = (weights[..., None] * points[faces]).sum(axis=1)
    number = len(points) + np.arange(len(faces))
    split = np.concatenate([np.stack([faces[:, a], faces[:, b], number], axis=1) for a, b in ((0, 1), (1, 2), (2, 0))])
    order = rng.permutation(len(points) + len(faces))
    inverse = np.argsort(order)
    return TriangleMesh(np.concatenate([points, centres])[order], inverse[split])


def write_ply(path, points: np.ndarray, faces: np.ndarray | None) -> None:
    """A scan as a file."""
    mesh = trimesh.PointCloud(points) if faces is None else trimesh.Trimesh(points, faces, process=False)
    mesh.export(path)


def write_ragged(path, scans: list[tuple[np.ndarray, np.ndarray | None]], **more) -> None:
    """Scans as ragged arrays."""
    arrays = {
        "points": np.concatenate([points for points, _ in scans]).astype(np.float32),
        "offsets": np.cumsum([0, *(len(points) for points, _ in scans)]),
    }
    if scans[0][1] is not None:
        arrays["faces"] = np.concatenate([faces for _, faces in scans])
        arrays["face_offsets"] = np.cumsum([0, *(len(faces) for _, faces in scans)])
    np.savez(path, **(arrays | more))
