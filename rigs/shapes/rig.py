"""Folders of sculpted shapes as rigs: one control for each primary shape; in-betweens and combinations follow by name."""

import logging
import math
from collections.abc import Sequence

from torch import Tensor

from riginv.errors import InputError
from riginv.rig.arkit import ArkitParts, arkit_deltas, arkit_parts
from riginv.rig.interface import Control, LinearRig
from riginv.rig.jacobian import Jacobian
from rigs.shapes.build import notes_of, shape_geometry
from rigs.shapes.folder import find_shapes
from rigs.shapes.logic import Combination, ShapeLogic
from rigs.shapes.names import Convention, misspelt_notes, read_names

LOG = logging.getLogger(__name__)


class ShapesRig(LinearRig):
    """A neutral mesh and one file for each shape; differentiable.

    Args:
        folder: folder of the files: .obj and .ply meshes, .npy, .npz and .safetensors deltas.
        neutral: name of the rest mesh's file, with or without suffix.
        include: globs for names or file names of the shapes to read.
        exclude: globs for names or file names of shapes to leave out.
        unit_mm: millimetres per unit of the files.
        corrective_names: whether `a50` is an in-between of `a`, and `a_b` the combination of `a` and `b`.
        combination: weight of a combination: `product` or `min` of the weights of its parts.
        deltas: meshes that contain deltas instead of sculpts: all, none, or those that match globs.

    Raises:
        InputError: the folder does not make a rig; the message names the file.
    """

    def __init__(
        self,
        folder: str,
        neutral: str = "neutral",
        include: Sequence[str] = ("*",),
        exclude: Sequence[str] = (),
        unit_mm: float = 1.0,
        corrective_names: bool = True,
        combination: Combination = "product",
        deltas: bool | Sequence[str] = False,
    ) -> None:
        if isinstance(unit_mm, bool) or not isinstance(unit_mm, int | float) or not 0 < unit_mm < math.inf:
            raise InputError(f"rig.unit_mm is {unit_mm!r}, expected how many mm the files' unit is, such as 10 for cm")
        for field, value in (("include", include), ("exclude", exclude), ("deltas", deltas)):
            if not (_are_globs(value) or (field == "deltas" and isinstance(value, bool))):
                raise InputError(f"rig.{field} is {value!r}, expected a list of globs, such as rig.{field}='[\"jaw*\"]'")
        if not isinstance(corrective_names, bool):
            raise InputError(f"rig.corrective_names is {corrective_names!r}, expected true or false")
        neutral_path, sources = find_shapes(folder, str(neutral), include, exclude, deltas)
        shapes = read_names(sources) if corrective_names else Convention(sorted(sources))
        logic = ShapeLogic(shapes, combination)
        geometry = shape_geometry(neutral_path, sources, shapes, logic, float(unit_mm))
        controls = [Control(name) for name in shapes.primaries]
        rest, faces, basis = geometry["rest_vertices"], geometry["faces"], geometry["basis"]
        name = neutral_path.resolve().parent.name
        super().__init__(name, controls, rest, faces, basis, shapes.names, primary_count=len(shapes.primaries))
        self.shapes, self.logic = shapes, logic
        self.mesh_file, self.unit_mm = neutral_path, float(unit_mm)
        self.contents, self.notes = shapes.counts(), (*misspelt_notes(shapes), *notes_of(geometry))
        LOG.debug(self.describe())

    def coefficients(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)`, the weights of the primary shapes, to the weights `(batch, shape)` of all shapes."""
        return self.logic(controls)

    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        return self.logic.with_jacobian(controls)

    def arkit_parts(self) -> dict[str, ArkitParts]:
        return arkit_parts(self.shapes.primaries)

    def arkit_deltas(self) -> dict[str, Tensor]:
        return arkit_deltas(self.arkit_parts(), dict(zip(self.shapes.primaries, self.basis)))

    def expressions(self) -> dict[str, dict[str, float]]:
        """Each shape as sculpted, primary shapes first."""
        return {name: dict(self.shapes.pose(name)) for name in self.shapes.names}

    def describe(self) -> str:
        """Interpretation of the names: one line for each corrective shape."""
        shapes = self.shapes
        lines = [f"{self.name}: {self.contents}"]
        lines += [f"  {name}: in-between of {shape} at {position:g}" for name, (shape, position) in shapes.inbetweens.items()]
        lines += [f"  {name}: combination of {' and '.join(parts)}" for name, parts in shapes.combinations.items()]
        inbetweens = shapes.combination_inbetweens.items()
        lines += [f"  {name}: in-between of {shape} at {position:g}" for name, (shape, position) in inbetweens]
        return "\n".join(lines)


def _are_globs(value: object) -> bool:
    return isinstance(value, list | tuple) and all(isinstance(glob, str) for glob in value)
