"""Drafts of DNA files from folders of shapes."""

from riginv.errors import InputError, listed
from rigs.dna.draft import Draft
from rigs.dna.exports.blendshapes import Drive, Factor, Shape, blendshape_draft, triangles
from rigs.shapes import ShapesRig
from rigs.shapes.names import Convention


def draft_of_shapes(rig: ShapesRig, drives: dict[str, Drive] | None = None) -> Draft:
    """A draft of a folder of shapes: in-betweens are hat functions, combinations products of weights and hats.

    Args:
        drives: of each primary shape, for a rig with other controls; default: each shape is a control.

    Raises:
        InputError: the format cannot represent the rig; the message has the reason.
    """
    shapes = rig.shapes
    if shapes.combinations and rig.logic.combine.__name__ != "combination_weights":
        raise InputError(
            f"rig '{rig.name}': rig.combination=min, where a DNA file holds products alone: use rig.combination=product"
        )
    if shapes.combination_inbetweens:
        names = list(shapes.combination_inbetweens)
        raise InputError(
            f"rig '{rig.name}': {len(names)} in-betweens of combinations ({listed(names)}), where a DNA file holds "
            f"in-betweens of single shapes alone: leave them out with rig.exclude"
        )
    hats = _hats(shapes)
    deltas = dict(zip(rig.coefficient_names, rig.basis.double().numpy(force=True)))

    def factors(name: str) -> list[Factor]:
        parts = shapes.combinations.get(name, (name,))
        return [hats[part] if part in hats else Factor(part, part) for part in parts]

    found = [Shape(name, factors(name), deltas[name]) for name in shapes.names]
    drives = drives or {name: Drive(name) for name in shapes.primaries}
    rest = rig.rest_vertices.double().numpy(force=True)
    return blendshape_draft(rig.name, rest, triangles(rig.faces.numpy(force=True)), drives, found)


def _hats(shapes: Convention) -> dict[str, Factor]:
    """Hat function of each in-between: 0 at its neighbours on the path from 0 to 1."""
    hats = {}
    for name, (owner, weight) in shapes.inbetweens.items():
        path = [0.0, *sorted(other for of, other in shapes.inbetweens.values() if of == owner), 1.0]
        number = path.index(weight)
        hats[name] = Factor(name, owner, (path[number - 1], weight, path[number + 1]))
    return hats
