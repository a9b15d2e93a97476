"""Runs inside Blender's Python: build a .blend from a saved blueprint. Needs nothing but bpy and NumPy.

    PYTHON build_blend.py BLUEPRINT.npz OUT.blend     or     blender --background --python build_blend.py -- BLUEPRINT.npz OUT.blend

Controls are custom properties of one object, `NAME controls`; weights of shapes are shape keys with drivers; what lies between
(a driver of a shape, a limit) are driven custom properties of a hidden object, `NAME logic`. All expressions are of the kind
that Blender computes itself, so an animator need not allow scripts.
"""

import json
import sys
import bpy
import numpy as np

METRES = 0.001  # per mm
PERCENT = 100.0  # curves get their inputs times this: Blender takes an input within 0.0001 of a key for the key
TERMS = 8  # of one expression, which may be 255 characters long


def main(blueprint, out):
    with np.load(blueprint, allow_pickle=False) as file:
        facts = json.loads(file["facts"].tobytes())
        rest, faces, deltas = file["rest_vertices"], file["faces"], file["deltas"]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.unit_settings.system = "METRIC"
    face = add_mesh(facts["name"], rest, faces)
    add_shape_keys(face, facts["shapes"], rest, deltas)
    controller = add_controls(facts, face)
    add_values(facts, face, controller)
    bpy.ops.wm.save_as_mainfile(filepath=out, compress=True, copy=True)


def upright(vertices):
    """Millimetres, y up, to metres, z up."""
    x, y, z = np.moveaxis(np.asarray(vertices, np.float64), -1, 0)
    return np.stack([x, -z, y], axis=-1) * METRES


def add_object(name, data, location=(0.0, 0.0, 0.0)):
    added = bpy.data.objects.new(name, data)
    added.location = location
    bpy.context.scene.collection.objects.link(added)
    return added


def add_mesh(name, rest, faces):
    vertices = upright(rest)
    # Near its origin a mesh of this size has the most digits in float32: errors add up over hundreds of shape keys.
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata((vertices - centre.astype(np.float32)).tolist(), [], faces.tolist())
    mesh.shade_smooth()
    return add_object(name, mesh, centre.tolist())


def add_shape_keys(face, names, rest, deltas):
    origin = np.array(face.location, np.float64)
    face.shape_key_add(name="Basis")
    for name, delta in zip(names, deltas):
        key = face.shape_key_add(name=name, from_mix=False)
        moved = upright(rest.astype(np.float64) + delta) - origin
        key.points.foreach_set("co", moved.astype(np.float32).ravel())
        if key.name != name:
            raise SystemExit(f"Blender cannot name a shape key '{name}'")


def add_controls(facts, face):
    size = max(face.dimensions)
    controller = add_object(f"{facts['name']} controls", None, face.location + bpy_vector(size, 0.0, 0.0))
    controller.empty_display_size = size / 10
    for control in facts["controls"]:
        controller[control["name"]] = float(control["neutral"])
        low, high = control["lower"], control["upper"]
        ui = controller.id_properties_ui(control["name"])
        ui.update(min=low, max=high, soft_min=low, soft_max=high, default=control["neutral"], description=control["unit"])
    return controller


def bpy_vector(*values):
    return type(bpy.context.scene.cursor.location)(values)


def add_values(facts, face, controller):
    logic = add_object(f"{facts['name']} logic", None)
    logic.hide_viewport = logic.hide_render = True
    keys, shapes = face.data.shape_keys, set(facts["shapes"])
    sources = {}

    def driven(name):
        if name in shapes:
            return keys, f'key_blocks["{name}"].value'
        logic[name] = 0.0
        return logic, f'["{name}"]'

    for value in facts["values"]:
        inputs = value["inputs"]
        path = [(controller, f'["{name}"]') for name in inputs] if value["of_controls"] else [sources[name] for name in inputs]
        factors = value["factors"]
        while len(path) > TERMS:  # sum a part by itself
            part = f"{value['name']} part {len(path)}"
            add_driver(*driven(part), "sum", path[:TERMS], factors[:TERMS], [])
            path, factors = [*path[TERMS:], (logic, f'["{part}"]')], [*factors[TERMS:], 1.0]
        sources[value["name"]] = driven(value["name"])
        add_driver(*sources[value["name"]], value["operation"], path, factors, value["curve"])


def expression(operation, factors, count):
    names = [f"v{number}" for number in range(count)]
    if operation == "sum":
        return "+".join(name if factor == 1 else f"{factor!r}*{name}" for factor, name in zip(factors, names))
    if operation == "product":
        return "*".join(names)
    if operation == "screen":
        return "1-" + "*".join(f"(1-{name})" for name in names)
    return f"min({','.join(names)})"


def add_driver(owner, path, operation, inputs, factors, curve):
    fcurve = owner.driver_add(path)
    for modifier in list(fcurve.modifiers):
        fcurve.modifiers.remove(modifier)
    while fcurve.keyframe_points:  # Blender adds two of its own
        fcurve.keyframe_points.remove(fcurve.keyframe_points[0], fast=True)
    driver = fcurve.driver
    driver.type = "SCRIPTED"
    for number, (source, source_path) in enumerate(inputs):
        variable = driver.variables.new()
        variable.name, variable.type = f"v{number}", "SINGLE_PROP"
        target = variable.targets[0]
        target.id_type = "KEY" if isinstance(source, bpy.types.Key) else "OBJECT"
        target.id, target.data_path = source, source_path
    text = expression(operation, factors, len(inputs))
    driver.expression = f"{PERCENT:g}*({text})" if curve else text
    if not driver.is_simple_expression:
        raise SystemExit(f"Blender cannot compute '{driver.expression}' without scripts")
    fcurve.extrapolation = "CONSTANT"
    fcurve.keyframe_points.add(len(curve))
    for point, (x, y, left, right) in zip(fcurve.keyframe_points, curve):
        point.interpolation, point.handle_left_type, point.handle_right_type = "BEZIER", "FREE", "FREE"
        point.co = PERCENT * x, y
        point.handle_left = PERCENT * (x + left[0]), y + left[1]
        point.handle_right = PERCENT * (x + right[0]), y + right[1]


if __name__ == "__main__":
    main(*(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]))
