"""Takes of markers as files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from riginv.rig.interface import LinearRig
from riginv.tracking.markers.placement import Placement, at_vertices


def placed(rig: LinearRig, count: int, offset_mm: float | None = 0.0) -> Placement:
    """Markers at evenly spread vertices."""
    vertices = np.linspace(0, len(rig.rest_vertices) - 1, count).astype(int).tolist()
    return at_vertices(rig, [f"m{number:02d}" for number in range(count)], vertices, offset_mm)


def played(rig: LinearRig, frames: int) -> torch.Tensor:
    """Controls `(frame, control)` that move smoothly within the limits."""
    phase = torch.linspace(0, 3, frames)[:, None] + torch.arange(len(rig.controls))
    return rig.lower + (rig.upper - rig.lower) * (0.35 + 0.3 * torch.sin(phase))


def write_c3d(path: Path, names: Sequence[str], points: np.ndarray, fps: float = 30.0, unit: str = "mm") -> Path:
    """A C3D file of points `(frame, marker, 3)`, NaN in gaps, by the library ezc3d."""
    import ezc3d

    file = ezc3d.c3d()
    group = file["parameters"]["POINT"]
    group["UNITS"]["value"], group["RATE"]["value"], group["LABELS"]["value"] = [unit], [fps], tuple(names)
    values = np.ones((4, len(names), len(points)))
    values[:3] = points.transpose(2, 1, 0)
    file["data"]["points"] = values
    file.write(str(path))
    return path


def write_trc(path: Path, names: Sequence[str], points: np.ndarray, fps: float = 30.0, unit: str = "mm") -> Path:
    """A TRC file as OpenSim writes it."""
    count = f"{fps:.2f}\t{fps:.2f}\t{len(points)}\t{len(names)}\t{unit}\t{fps:.2f}\t1\t{len(points)}"
    lines = [f"PathFileType\t4\t(X/Y/Z)\t{path.name}"]
    lines += ["DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames", count]
    lines += [
        "Frame#\tTime\t" + "\t\t\t".join(names),
        "\t\t" + "\t".join(f"{a}{n + 1}" for n in range(len(names)) for a in "XYZ"),
    ]
    for number, frame in enumerate(points, start=1):
        cells = ["" if np.isnan(value) else f"{value:.4f}" for value in frame.flatten()]
        lines.append("\t".join([str(number), f"{(number - 1) / fps:.4f}", *cells]))
    path.write_text("\n".join([*lines[:5], "", *lines[5:]]) + "\n")
    return path


def write_csv(path: Path, names: Sequence[str], points: np.ndarray, fps: float = 30.0) -> Path:
    """A CSV file with columns NAME.x, NAME.y, NAME.z."""
    lines = [",".join(["frame", "time", *(f"{name}.{axis}" for name in names for axis in "xyz")])]
    for number, frame in enumerate(points):
        cells = ["" if np.isnan(value) else f"{value:.4f}" for value in frame.flatten()]
        lines.append(",".join([str(number), f"{number / fps:.5f}", *cells]))
    path.write_text("\n".join(lines) + "\n")
    return path


def write_motive(path: Path, names: Sequence[str], points: np.ndarray, fps: float = 120.0, unit: str = "Millimeters") -> Path:
    """An export of Motive: a rigid body with its expected marker, the markers, and one without a name; from frame 7."""
    titles = [*(f"Face:{name}" for name in names), "Unlabeled 1042"]
    kinds = ["Rigid Body"] * 4 + ["Rigid Body Marker"] * 3 + ["Marker"] * 3 * len(titles)
    rows = [
        ["Format Version", "1.23", "Take Name", '"A take, of 2026"', "Export Frame Rate", f"{fps:.6f}", "Length Units", unit],
        [],
        ["", "Type", *kinds],
        ["", "Name", *["head"] * 4, *["Face:nose"] * 3, *(title for title in titles for _ in range(3))],
        ["", "ID", *["A1"] * len(kinds)],
        ["", "", "Rotation", *["Position"] * (len(kinds) - 1)],
        ["Frame", "Time (Seconds)", "W", *["X", "Y", "Z"] * (2 + len(names) + 1)],
    ]
    rows += [[str(7 + n), f"{n / fps:.6f}", *["9"] * 7, *_cells(frame), *["5"] * 3] for n, frame in enumerate(points)]
    path.write_text("\n".join(map(",".join, rows)) + "\n")
    return path


def write_vicon(path: Path, names: Sequence[str], points: np.ndarray, fps: int = 100, unit: str = "mm") -> Path:
    """An export of Vicon Nexus: devices, the trajectories from frame 7, and joints."""
    rows = ["Devices", "1000", ",,Force", "Frame,Sub Frame,Fx", ",,N", "1,0,0.5", "", "Trajectories", str(fps)]
    rows += [",," + ",,,".join(f"Face:{name}" for name in names), "Frame,Sub Frame" + ",X,Y,Z" * len(names)]
    rows += [",," + ",".join([unit] * 3 * len(names))]
    rows += [",".join([str(7 + n), "0", *_cells(frame)]) for n, frame in enumerate(points)]
    path.write_text("\n".join([*rows, "", "Joints", "100", "x,y"]) + "\n")
    return path


def _cells(frame: np.ndarray) -> list[str]:
    return ["" if np.isnan(value) else f"{value:.4f}" for value in frame.flatten()]
