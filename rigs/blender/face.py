"""Blueprint of the default face."""

from rigs.blender.blueprint import Blueprint, Value, unpack_curves
from rigs.face import FaceRig
from rigs.face.limits import REGIONS


def face_blueprint(rig: FaceRig) -> Blueprint:
    """Blueprint of the face, from the tensors of `FaceRig.coefficients`."""
    shapes = rig.coefficient_names[: rig.primary_count]
    driven = _driven(rig, shapes)
    inputs: dict[str, str] = {}  # of each shape, before the limit of its region
    screens: list[Value] = []
    ceilings: list[Value] = []
    limits: list[Value] = []
    for shape, slots in zip(shapes, rig.driver_of_shape.tolist()):
        drivers = tuple(driven[slot].name for slot in slots if slot >= 0)
        inputs[shape] = drivers[0] if len(drivers) == 1 else f"{shape} driven"
        if len(drivers) > 1:
            screens.append(Value(inputs[shape], "screen", drivers))
    driven_by = dict(inputs)
    for shape, under, curve in zip(rig.ceiling_shape.tolist(), rig.ceiling_under.tolist(), unpack_curves(rig.ceiling_curves)):
        name = shapes[shape]
        inputs[name] = f"{name} clamped"
        ceilings.append(Value(f"{name} ceiling", "sum", (driven_by[shapes[under]],), (1.0,), curve))
        ceilings.append(Value(inputs[name], "least", (driven_by[name], f"{name} ceiling")))
    for number, (region, curve) in enumerate(zip(REGIONS, unpack_curves(rig.limit_curves))):
        takes = {inputs[shape]: float(take) for shape, take in zip(shapes, rig.capacity_taken[:, number]) if take > 0}
        limits.append(Value(f"{region} limit", "sum", tuple(takes), tuple(takes.values()), curve))
    region_of = [REGIONS[number] for number in rig.region_of_shape.tolist()]
    primary = [Value(shape, "product", (inputs[shape], f"{region} limit")) for shape, region in zip(shapes, region_of)]
    return Blueprint(
        rig.name,
        rig.controls,
        [*driven, *screens, *ceilings, *limits, *primary, *_corrections(rig, shapes)],
        rig.coefficient_names,
        rig.rest_vertices.cpu().numpy(),
        rig.faces.cpu().numpy(),
        rig.basis.cpu().numpy(),
    )


def _driven(rig: FaceRig, shapes: tuple[str, ...]) -> list[Value]:
    shape_of = {slot: shape for shape, slots in zip(shapes, rig.driver_of_shape.tolist()) for slot in slots if slot >= 0}
    controls = [rig.control_names[number] for number in rig.driver_control.tolist()]
    curves = unpack_curves(rig.driver_curves)
    return [
        Value(f"{shape_of[slot]} by {control}", "sum", (control,), (1.0,), curve, of_controls=True)
        for slot, (control, curve) in enumerate(zip(controls, curves))
    ]


def _corrections(rig: FaceRig, shapes: tuple[str, ...]) -> list[Value]:
    names = rig.coefficient_names[rig.primary_count :]
    curves = unpack_curves(rig.inbetween_curves)
    between = [
        Value(name, "sum", (shapes[shape],), (1.0,), curve)
        for name, shape, curve in zip(names, rig.inbetween_shape.tolist(), curves)
    ]
    members = rig.combination_members.tolist()
    combined = [
        Value(name, "product", tuple(shapes[shape] for shape in group if shape >= 0))
        for name, group in zip(names[len(between) :], members)
    ]
    return [*between, *combined]
