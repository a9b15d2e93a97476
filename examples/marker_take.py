"""A take of 50 markers on the default face, with noise, gaps and two labels that are exchanged for a while.

    python examples/marker_take.py folder
    python -m riginv.markers rig=face clip=folder/take.trc frame=1 out=folder/map.yaml
    python -m riginv.invert rig=face correspondence=markers clip=folder/take.trc markers=folder/map.yaml out=folder/found
    python examples/marker_take.py folder --compare folder/found

The first frame is neutral, as somebody's face at rest is recorded before a take. The controls that made the take are kept in
`truth.npz`: `--compare` says how far the meshes of the found curves are from theirs.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from riginv.clips.control_curves import csv_curves
from riginv.clips.csv_table import read_csv
from riginv.tracking.markers.layout import NOISE_MM as LAYOUT_NOISE_MM
from riginv.tracking.markers.layout import suggest_layout
from riginv.tracking.priors.performances import default_prior
from rigs.face import FaceRig

FRAMES, FPS, MARKERS = 120, 30, 50
OFFSET_MM, NOISE_MM, DROPPED = 2.0, 0.3, 0.1
EXCHANGED, SPAN = (3, 9), slice(60, 80)  # markers, and frames
MOVES = {  # control: value at its height, and the frame
    "jawOpen": (0.6, 30),
    "mouthSmileLeft": (0.8, 50),
    "mouthSmileRight": (0.8, 50),
    "browInnerUp": (0.7, 70),
    "mouthPucker": (0.7, 90),
    "eyeBlinkLeft": (1.0, 75),
    "eyeBlinkRight": (1.0, 75),
}


def performance(rig: FaceRig) -> torch.Tensor:
    """The controls `(frame, control)` of the take."""
    controls = rig.neutral_controls.repeat(FRAMES, 1)
    for name, (value, middle) in MOVES.items():
        controls[:, rig.control_names.index(name)] = value * torch.exp(-(((torch.arange(FRAMES) - middle) / 8.0) ** 2))
    return controls


def make(folder: Path) -> None:
    """Write take.trc and truth.npz."""
    rig, rng = FaceRig(), np.random.default_rng(0)
    controls = performance(rig)
    placement = suggest_layout(rig, default_prior(rig), MARKERS, LAYOUT_NOISE_MM, OFFSET_MM)
    with torch.no_grad():
        points = placement.points(rig(controls)).double().numpy()
    points += rng.normal(0, NOISE_MM, points.shape)
    points[1:][rng.random((FRAMES - 1, MARKERS)) < DROPPED] = np.nan
    phase, middle = np.arange(FRAMES) / 25, np.nanmean(points, axis=(0, 1))
    angles = 12 * np.sin(np.stack([phase, 1.5 * phase, 0 * phase], axis=1))
    points = (points - middle) @ Rotation.from_euler("xyz", angles, degrees=True).as_matrix().transpose(0, 2, 1)
    points += middle + 30 * np.sin(phase)[:, None, None]
    points[SPAN, EXCHANGED] = points[SPAN, EXCHANGED[::-1]]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "take.trc").write_text(trc(placement.names, points), encoding="utf-8")
    np.savez(folder / "truth.npz", controls=controls.numpy())
    exchanged = " and ".join(placement.names[number] for number in EXCHANGED)
    print(f"{folder / 'take.trc'}: {FRAMES} frames of {MARKERS} markers; {exchanged} are exchanged in frames 61 to 80")


def trc(names: tuple[str, ...], points: np.ndarray) -> str:
    """Markers `(frame, marker, 3)`, mm, as a TRC file."""
    lines = ["PathFileType\t4\t(X/Y/Z)\ttake.trc", "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits"]
    lines += [f"{FPS}\t{FPS}\t{len(points)}\t{len(names)}\tmm", "Frame#\tTime\t" + "\t\t\t".join(names)]
    lines += ["\t\t" + "\t".join(f"{axis}{number + 1}" for number in range(len(names)) for axis in "XYZ"), ""]
    for number, frame in enumerate(points):
        cells = ["" if np.isnan(value) else f"{value:.3f}" for value in frame.flatten()]
        lines.append("\t".join([str(number + 1), f"{number / FPS:.4f}", *cells]))
    return "\n".join(lines) + "\n"


@torch.no_grad()
def compare(folder: Path, found: Path) -> None:
    """Print the mean distance of the found meshes from those of the take."""
    rig = FaceRig()
    curves = csv_curves(read_csv(found / "curves.csv"))
    names = curves.names or []
    controls = torch.from_numpy(curves.values[:, [names.index(name) for name in rig.control_names]]).float()
    truth = rig(torch.from_numpy(np.load(folder / "truth.npz")["controls"]))[curves.frame_numbers - 1]  # the take counts from 1
    errors, neutral = (rig(controls) - truth).norm(dim=2).mean(dim=1), (rig.rest_vertices - truth).norm(dim=2).mean()
    print(f"mean error of all {truth.shape[1]:,} vertices: {errors.mean():.2f} mm, worst frame {errors.max():.2f} mm", end="")
    print(f" (neutral {neutral:.2f} mm)")


def main(about: str | None, make: Callable[[Path], None]) -> None:
    """Make a take, or compare what was found of it with the truth, as the command line says."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--compare", type=Path, default=None, help="the folder of riginv.invert")
    given = parser.parse_args()
    if given.compare is None:
        make(given.folder)
    else:
        compare(given.folder, given.compare)


if __name__ == "__main__":
    main(__doc__, make)
