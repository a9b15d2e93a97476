"""Inside Blender: drivers with simple expressions, which Blender evaluates without Python, and their curves."""

import bpy

PERCENT = 100.0  # scale of curve inputs: Blender snaps inputs within 0.0001 to a key
TERMS = 8  # most terms of an expression, which may have 255 characters

Property = tuple[bpy.types.ID, str, int]  # datablock, path, index or -1


def add_driver(target_property: Property, operation: str, sources: list[Property], factors: list[float], curve: list) -> None:
    """Drive a property by others."""
    owner, path, index = target_property
    fcurve = owner.driver_add(path, index) if index >= 0 else owner.driver_add(path)
    for modifier in list(fcurve.modifiers):
        fcurve.modifiers.remove(modifier)
    while fcurve.keyframe_points:  # Blender adds two by default
        fcurve.keyframe_points.remove(fcurve.keyframe_points[0], fast=True)
    driver = fcurve.driver
    driver.type = "SCRIPTED"
    for number, (source, source_path, source_index) in enumerate(sources):
        variable = driver.variables.new()
        variable.name, variable.type = f"v{number}", "SINGLE_PROP"
        target = variable.targets[0]
        target.id_type = source.id_type
        target.id, target.data_path = source, source_path + (f"[{source_index}]" if source_index >= 0 else "")
    text = expression(operation, factors, len(sources))
    driver.expression = f"{PERCENT:g}*({text})" if curve else text
    if not driver.is_simple_expression:
        raise SystemExit(f"Blender cannot compute '{driver.expression}' without scripts")
    add_keys(fcurve, curve)


def expression(operation: str, factors: list[float], count: int) -> str:
    """Blender's expression of an operation on v0, v1..."""
    names = [f"v{number}" for number in range(count)]
    if operation == "sum":
        return "+".join(name if factor == 1 else f"{factor!r}*{name}" for factor, name in zip(factors, names))
    if operation == "product":
        return "*".join(names)
    if operation == "screen":
        return "1-" + "*".join(f"(1-{name})" for name in names)
    return f"min({','.join(names)})"


def add_keys(fcurve: bpy.types.FCurve, curve: list) -> None:
    """Add the keys of a curve with their handles; it is constant beyond them."""
    fcurve.extrapolation = "CONSTANT"
    fcurve.keyframe_points.add(len(curve))
    for point, (x, y, left, right) in zip(fcurve.keyframe_points, curve):
        point.interpolation, point.handle_left_type, point.handle_right_type = "BEZIER", "FREE", "FREE"
        point.co = PERCENT * x, y
        point.handle_left = PERCENT * (x + left[0]), y + left[1]
        point.handle_right = PERCENT * (x + right[0]), y + right[1]
