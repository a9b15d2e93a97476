"""The blueprint of the default face: its drivers, screens, limits, in-betweens and combinations as values."""

from riginv.geometry.curves import Key
from rigs.blender.blueprint import Blueprint, Value, unpack_curves
from rigs.face import FaceRig
from rigs.face.limits import REGIONS


def face_blueprint(rig: FaceRig) -> Blueprint:
    """What `FaceRig.coefficients` does, value by value, read from the tensors that it computes with."""
    shapes = rig.coefficient_names[: rig.primary_count]
    driven = _driven(rig, shapes)
    asked, screens, ceilings, limits = {}, [], [], []
    for shape, slots in zip(shapes, rig.driver_of_shape.tolist()):
        drivers = tuple(driven[slot].name for slot in slots if slot >= 0)
        asked[shape] = drivers[0] if len(drivers) == 1 else f"{shape} asked"
        if len(drivers) > 1:
            screens.append(Value(asked[shape], "screen", drivers))
    freely = dict(asked)
    for shape, under, curve in zip(rig.ceiling_shape, rig.ceiling_under, unpack_curves(rig.ceiling_curves)):
        name = shapes[shape]
        asked[name] = f"{name} allowed"
        ceilings.append(Value(f"{name} ceiling", "sum", (freely[shapes[under]],), (1.0,), curve))
        ceilings.append(Value(asked[name], "least", (freely[name], f"{name} ceiling")))
    for number, (region, curve) in enumerate(zip(REGIONS, unpack_curves(rig.limit_curves))):
        takes = {asked[shape]: float(take) for shape, take in zip(shapes, rig.capacity_taken[:, number]) if take > 0}
        limits.append(Value(f"{region} limit", "sum", tuple(takes), tuple(takes.values()), curve))
    region_of = [REGIONS[number] for number in rig.region_of_shape.tolist()]
    primary = [Value(shape, "product", (asked[shape], f"{region} limit")) for shape, region in zip(shapes, region_of)]
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
    curves: list[list[Key]] = unpack_curves(rig.driver_curves)
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
