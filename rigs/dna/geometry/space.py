"""Conversion of coordinates to riginv's: millimetres, x to the character's left, y up, z to the front."""

from dataclasses import dataclass

import numpy as np

from riginv.errors import InputError
from rigs.dna.format import DnaFile
from rigs.dna.format.later_layers import Conventions
from rigs.dna.format.layers import Descriptor, Geometry

UNITS_MM = {0: 10.0, 1: 1000.0}  # cm, m
UNIT_NAMES = {0: "centimetres", 1: "metres"}
DIRECTIONS = {0: (-1, 0, 0), 1: (1, 0, 0), 2: (0, 1, 0), 3: (0, -1, 0), 4: (0, 0, 1), 5: (0, 0, -1)}  # left ... back
SMALLEST_MM, LARGEST_MM = 30.0, 10_000.0  # plausible sizes of a character
FARTHEST_MM = 1e8


@dataclass(frozen=True)
class Space:
    """The map p -> unit_mm * axes p.

    Attributes:
        unit_mm: millimetres per unit of length of the file.
        axes: `(3, 3)`, orthogonal; the columns are the directions of the file's axes.
        flips_faces: whether the winding of faces is reversed.
        stated_unit: name of the file's unit; None where the user gives `unit_mm`.
    """

    unit_mm: float
    axes: np.ndarray
    flips_faces: bool
    stated_unit: str | None = None

    @classmethod
    def of(cls, file: DnaFile, unit_mm: float | None = None) -> "Space":
        """The space of a file.

        Args:
            unit_mm: millimetres per unit; None: as the file states.

        Raises:
            InputError: units or axes are not known.
        """
        descriptor, conventions = file.need(Descriptor), file.find(Conventions)
        axes, unit = descriptor.axes, descriptor.translation_unit
        numbers = (axes.x, axes.y, axes.z)
        if any(number not in DIRECTIONS for number in numbers) or len({number // 2 for number in numbers}) < 3:
            raise InputError(
                f"{file.path}: its axes x, y, z point in directions {numbers}, expected three different ones of 0 (left), "
                f"1 (right), 2 (up), 3 (down), 4 (front), 5 (back): the file is damaged; export it again"
            )
        if unit_mm is None and unit not in UNITS_MM:
            raise InputError(
                f"{file.path}: its unit of length is number {unit}, expected 0 (cm) or 1 (m): say how many millimetres it is "
                f"with rig.unit_mm=10"
            )
        columns = np.array([DIRECTIONS[number] for number in numbers], dtype=np.float64).T
        clockwise = conventions is not None and conventions.winding == 1
        flips = clockwise != (np.linalg.det(columns) < 0)
        stated = UNIT_NAMES[unit] if unit_mm is None else None
        return cls(UNITS_MM[unit] if unit_mm is None else float(unit_mm), columns, bool(flips), stated)

    def vectors(self, values: np.ndarray) -> np.ndarray:
        """Vectors `(..., 3)` of the file, mm along riginv's axes."""
        return values.astype(np.float64) @ (self.unit_mm * self.axes).T

    def points_in_file(self, points: np.ndarray) -> np.ndarray:
        """Points `(..., 3)` of riginv as the file has them."""
        return points @ self.axes / self.unit_mm

    def transforms_in_file(self, transforms: np.ndarray, centre: np.ndarray) -> np.ndarray:
        """Transforms of joints `(..., 3, 4)` as the file has them.

        Args:
            centre: `(3,)`, mm: the origin of the translations.
        """
        linear = self.axes.T @ transforms[..., :3]
        positions = self.points_in_file(transforms[..., 3] + centre)
        return np.concatenate([linear, positions[..., None]], axis=-1)

    def check_size(self, file: DnaFile, rest: np.ndarray) -> None:
        """Raises InputError where the size of the meshes is implausible for the unit that the file states."""
        if not np.abs(rest).max(initial=0.0) < FARTHEST_MM:
            raise InputError(f"{file.path}: its vertices lie farther than 100 km from the origin: the file is damaged")
        meshes = [mesh.positions for mesh in file.need(Geometry).meshes]
        size = 0.0
        for name in ("xs", "ys", "zs"):
            values = np.concatenate([getattr(positions, name) for positions in meshes]).astype(np.float64)
            values = values[np.isfinite(values)]
            size = max(size, self.unit_mm * float(np.ptp(values)) if len(values) else 0.0)
        if self.stated_unit is not None and not SMALLEST_MM <= size <= LARGEST_MM:
            raise InputError(
                f"{file.path}: its meshes are {size:.4g} mm large where coordinates are {self.stated_unit}, as the file "
                f"states, expected {SMALLEST_MM:g} to {LARGEST_MM:g} mm: say what a unit is with rig.unit_mm=10 (cm) or "
                f"rig.unit_mm=1000 (m); any rig.unit_mm is taken as it is"
            )
