"""A sequence of scans of the default face: another topology in every frame, noise, holes and head motion.

    pip install fast-simplification
    python examples/scan_take.py folder
    python -m riginv.invert rig=face clip='folder/scan.%04d.ply' out=folder/found
    python examples/scan_take.py folder --compare folder/found

The scans are every third frame of examples/marker_take.py. The controls that made them are kept in `truth.npz`: `--compare`
says how far the meshes of the found curves are from theirs. Six landmarks are in `landmarks.trc`, with 2 mm of noise, and
their places on the rig in `landmarks.yaml`: `landmarks.map=folder/landmarks.yaml landmarks.clip=folder/landmarks.trc`.
"""

from pathlib import Path

import fast_simplification
import numpy as np
import torch
import trimesh
from marker_take import main, performance, trc
from scipy.spatial.transform import Rotation

from riginv.tracking.markers.layout import suggest_layout
from riginv.tracking.markers.map_file import write_map
from riginv.tracking.priors.performances import default_prior
from rigs.face import FaceRig

STEP, FACES_KEPT, NOISE_MM, HOLES, HOLE_MM = 3, 0.4, 0.2, 4, 12.0
LANDMARKS, LANDMARK_NOISE_MM = 6, 2.0


@torch.no_grad()
def make(folder: Path) -> None:
    """Write scan.0001.ply and so on, truth.npz, and the landmarks."""
    rig, rng, landmarks = FaceRig(), np.random.default_rng(0), []
    placement = suggest_layout(rig, default_prior(rig), LANDMARKS, LANDMARK_NOISE_MM, 0.0)
    controls, faces = performance(rig)[::STEP], rig.faces.numpy()
    folder.mkdir(parents=True, exist_ok=True)
    for number, mesh in enumerate(rig(controls).double().numpy()):
        points, triangles = trimesh.remesh.subdivide(mesh, faces)
        sizes = points.astype(np.float32), triangles.astype(np.int32)
        points, triangles = fast_simplification.simplify(*sizes, target_count=int(FACES_KEPT * len(faces)))
        for middle in points[rng.integers(0, len(points), HOLES)]:
            triangles = triangles[np.linalg.norm(points[triangles].mean(axis=1) - middle, axis=1) > HOLE_MM]
        head = Rotation.from_euler("xyz", 12 * np.sin(number / 8 * np.array([1.0, 1.5, 0.0])), degrees=True)
        points = head.apply(points + rng.normal(0, NOISE_MM, points.shape)) + 30 * np.sin(number / 8)
        landmarks.append(head.apply(placement.points(torch.from_numpy(mesh)).numpy()) + 30 * np.sin(number / 8))
        trimesh.Trimesh(points, triangles, process=False).export(folder / f"scan.{number + 1:04d}.ply")
    noise = np.random.default_rng(1).normal(0, LANDMARK_NOISE_MM, (len(landmarks), LANDMARKS, 3))
    (folder / "landmarks.trc").write_text(trc(placement.names, np.stack(landmarks) + noise), encoding="utf-8")
    write_map(folder / "landmarks.yaml", placement, rig)
    np.savez(folder / "truth.npz", controls=controls.numpy())
    print(f"{folder / 'scan.%04d.ply'}: {len(controls)} scans of about {len(triangles):,} triangles")


if __name__ == "__main__":
    main(__doc__, make)
