"""Two-sided animator's controls over the primary shapes of a folder."""

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.interface import Control, LinearRig
from riginv.rig.jacobian import Factor, Jacobian, Pattern
from riginv.runs.files import read_json
from rigs.dna.draft import Draft
from rigs.dna.exports.blendshapes import Drive
from rigs.dna.exports.shapes import draft_of_shapes
from rigs.shapes import ShapesRig

SIDES = {"positive": 1.0, "negative": -1.0}


class StudioFaceRig(LinearRig):
    """A control drives a shape above 0, another one below 0, or both: weight = clamp(sign * control, 0, 1).

    In-betweens and combinations follow from the weights of the primary shapes, as for `rig=shapes`.

    Args:
        folder: of the shapes, as for `rig=shapes`.
        controls: JSON file in this folder: `{"jaw_x": {"positive": "jawLeft", "negative": "jawRight"}, ...}`.
        unit_mm: millimetres per unit of the files.

    Raises:
        InputError: the files do not make a rig; the message names the file.
    """

    owner: Tensor
    sign: Tensor

    def __init__(self, folder: str, controls: str = "controls.json", unit_mm: float = 1.0) -> None:
        shapes = ShapesRig(folder, unit_mm=unit_mm)
        path = Path(folder) / controls
        table = read_json(path)
        drives = read_drives(path, table, shapes.control_names)
        limits = [Control(name, lower=-1.0 if "negative" in sides else 0.0) for name, sides in table.items()]
        names, count = shapes.coefficient_names, shapes.primary_count
        super().__init__(shapes.name, limits, shapes.rest_vertices, shapes.faces, shapes.basis, names, count)
        order = [drives[name] for name in shapes.control_names]
        self.register_buffer("owner", torch.tensor([list(table).index(drive.gui) for drive in order]), persistent=False)
        self.register_buffer("sign", torch.tensor([drive.one for drive in order]), persistent=False)
        self.shapes, self.drives = shapes, drives
        self.mesh_file, self.unit_mm, self.notes = shapes.mesh_file, shapes.unit_mm, shapes.notes
        self.contents = f"{sum(control.lower < 0 for control in limits)} of them two-sided, {shapes.contents}"

    def primary_weights(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to the weights of the primary shapes `(batch, shape)`."""
        return (self.sign.to(controls) * controls[:, self.owner]).clamp(0, 1)

    def coefficients(self, controls: Tensor) -> Tensor:
        return self.shapes.coefficients(self.primary_weights(controls))

    @torch.no_grad()
    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        """As the base class by automatic differentiation, many times as fast: solvers need it at every step."""
        found, jacobian = self.shapes.coefficient_jacobian(self.primary_weights(controls))
        driven = self.sign.to(controls) * controls[:, self.owner]
        values = torch.where((driven >= 0) & (driven <= 1), self.sign.to(controls), 0.0)
        pattern = Pattern(torch.arange(len(self.owner)).to(self.owner), self.owner, (len(self.owner), len(self.controls)))
        return found, Jacobian((*jacobian.factors, Factor(pattern, values)))

    def expressions(self) -> dict[str, dict[str, float]]:
        """Each shape as sculpted, without those that no pose of the controls reaches."""
        poses = {}
        for shape, weights in self.shapes.expressions().items():
            pose = {self.drives[name].gui: self.drives[name].at(weight) for name, weight in weights.items()}
            if len(pose) == len(weights):
                poses[shape] = pose
        return poses

    def dna_draft(self) -> Draft:
        """What `rigs.dna.export` writes: the controls are the file's GUI controls."""
        return draft_of_shapes(self.shapes, self.drives)


def read_drives(path: Path, table: Mapping[str, object], shapes: tuple[str, ...]) -> dict[str, Drive]:
    """The control that drives each primary shape, from the content of a JSON file.

    Raises:
        InputError: a control drives no shape or unknown ones, or a shape is driven by none or by two.
    """
    found: dict[str, Drive] = {}
    for control, sides in table.items():
        if not isinstance(sides, dict) or "positive" not in sides or not sides.keys() <= SIDES.keys():
            raise InputError(f"{path}: control '{control}' is {sides!r}, expected positive: SHAPE and perhaps negative: SHAPE")
        for side, shape in sides.items():
            if shape not in shapes:
                raise InputError(f"{path}: control '{control}' drives '{shape}', expected a primary shape of the folder")
            if shape in found:
                raise InputError(f"{path}: shape '{shape}' is driven by '{found[shape].gui}' and '{control}': leave one out")
            found[shape] = Drive(control, 0.0, SIDES[side])
    if missing := [shape for shape in shapes if shape not in found]:
        raise InputError(f"{path}: no control drives shape '{missing[0]}' ({len(missing)} such shapes): add one")
    return found
