"""Runs inside Blender's Python: build a .blend from a saved blueprint (rigs/blender/blueprint.py).

    PYTHON build_blend.py BLUEPRINT.npz OUT.blend
    blender --background --python build_blend.py -- BLUEPRINT.npz OUT.blend

Controls are custom properties of one object, `NAME controls`; weights of shapes are shape keys with drivers, joints are bones
with drivers; intermediate values are driven custom properties of a hidden object, `NAME logic`. All expressions are simple
ones that Blender evaluates without Python, so an animator need not allow scripts.
"""

import json
import os
import sys
from typing import Any

import bpy
import numpy as np

METRES = 0.001  # per mm


def main(blueprint: str, out: str) -> None:
    """Build and save."""
    with np.load(blueprint, allow_pickle=False) as file:
        facts = json.loads(file["facts"].tobytes())
        arrays = {name: file[name] for name in file.files if name != "facts"}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.unit_settings.system = "METRIC"
    mesh = add_mesh(facts["name"], arrays)
    add_shape_keys(mesh, facts["shapes"], arrays)
    armature = add_armature(mesh, facts["skeleton"], arrays) if facts["skeleton"] else None
    controller = add_controls(facts, mesh)
    add_values(facts, mesh, armature, controller)
    bpy.ops.wm.save_as_mainfile(filepath=out, compress=True, copy=True)


def upright(vertices: np.ndarray) -> np.ndarray:
    """From y up to z up, in float64."""
    x, y, z = np.moveaxis(np.asarray(vertices, np.float64), -1, 0)
    return np.stack([x, -z, y], axis=-1)


def add_object(name: str, data: Any, location: Any = (0.0, 0.0, 0.0)) -> bpy.types.Object:
    """A new object in the scene."""
    added = bpy.data.objects.new(name, data)
    added.location = location
    bpy.context.scene.collection.objects.link(added)
    return added


def add_mesh(name: str, arrays: dict[str, np.ndarray]) -> bpy.types.Object:
    """The rest mesh as an object, in metres."""
    vertices = upright(arrays["rest_vertices"]) * METRES
    # Centred for float32 precision: rounding errors add up over hundreds of shape keys.
    centre = ((vertices.min(axis=0) + vertices.max(axis=0)) / 2).astype(np.float32)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata((vertices - centre).tolist(), [], arrays["faces"].tolist())
    mesh.shade_smooth()
    return add_object(name, mesh, centre.tolist())


def add_shape_keys(mesh: bpy.types.Object, names: list[str], arrays: dict[str, np.ndarray]) -> None:
    """The shapes as relative shape keys."""
    origin = np.array(mesh.location, np.float64)
    for name, delta in zip(["Basis", *names] if names else [], [0.0, *arrays["deltas"]]):
        key = mesh.shape_key_add(name=name, from_mix=False)
        moved = upright(arrays["rest_vertices"].astype(np.float64) + delta) * METRES - origin
        key.points.foreach_set("co", moved.astype(np.float32).ravel())
        if key.name != name:
            raise SystemExit(f"Blender cannot name a shape key '{name}'")


def add_armature(mesh: bpy.types.Object, skeleton: dict, arrays: dict[str, np.ndarray]) -> bpy.types.Object:
    """The skeleton as an armature that deforms the mesh; all channels are locked."""
    names, origin = skeleton["names"], np.array(mesh.location, np.float64)
    heads = upright(arrays["heads"]) * METRES - origin
    frames = np.stack([upright(arrays["frames"][..., axis]) for axis in range(3)], axis=-1)
    armature = add_object(f"{mesh.name} skeleton", bpy.data.armatures.new(f"{mesh.name} skeleton"), mesh.location)
    armature.show_in_front = True
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for name, parent, head, frame, length in zip(names, skeleton["parents"], heads, frames, arrays["lengths"]):
        bone = armature.data.edit_bones.new(name)
        bone.head, bone.tail = head.tolist(), (head + frame[:, 1] * length * METRES).tolist()
        bone.align_roll(frame[:, 2].tolist())
        bone.parent = armature.data.edit_bones[names[parent]] if parent >= 0 else None
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone in armature.pose.bones:
        bone.rotation_mode = skeleton["order"]
        bone.lock_location, bone.lock_rotation, bone.lock_scale = [(True, True, True)] * 3
    for joint, name in enumerate(names):
        group = mesh.vertex_groups.new(name=name)
        for vertex in np.flatnonzero(arrays["weights"][:, joint]).tolist():
            group.add([vertex], float(arrays["weights"][vertex, joint]), "REPLACE")
    mesh.modifiers.new("skeleton", "ARMATURE").object = armature
    return armature


def add_controls(facts: dict, mesh: bpy.types.Object) -> bpy.types.Object:
    """An empty beside the mesh whose custom properties are the controls."""
    size = max(mesh.dimensions)
    controller = add_object(f"{facts['name']} controls", None, (mesh.location.x + size, mesh.location.y, mesh.location.z))
    controller.empty_display_size = size / 10
    for control in facts["controls"]:
        controller[control["name"]] = float(control["neutral"])
        low, high = control["lower"], control["upper"]
        ui = controller.id_properties_ui(control["name"])
        ui.update(min=low, max=high, soft_min=low, soft_max=high, default=control["neutral"], description=control["unit"])
    return controller


def add_values(facts: dict, mesh: bpy.types.Object, armature: bpy.types.Object | None, controller: bpy.types.Object) -> None:
    """A driver for each value, on a shape key, a bone or a property of the hidden object."""
    logic = add_object(f"{facts['name']} logic", None)
    logic.hide_viewport = logic.hide_render = True
    shapes, channels = set(facts["shapes"]), (facts["skeleton"] or {}).get("channels", {})
    properties = {}  # datablock, path and index of each value

    def property_of(name: str) -> tuple:
        if name in shapes:
            return mesh.data.shape_keys, f'key_blocks["{name}"].value', -1
        if name in channels:
            joint, kind, axis = channels[name]
            return armature, f'pose.bones["{joint}"].{"rotation_euler" if kind == "rotation" else kind}', axis
        logic[name] = 0.0
        return logic, f'["{name}"]', -1

    for value in facts["values"]:
        name, inputs, factors = value["name"], value["inputs"], value["factors"]
        if value["of_controls"]:
            sources = [(controller, f'["{control}"]', -1) for control in inputs]
        else:
            sources = [properties[other] for other in inputs]
        if channels.get(name, ("", ""))[1] == "location":
            factors = [factor * METRES for factor in factors]
        while len(sources) > TERMS:  # partial sums
            part = property_of(f"{name} part {len(sources)}")
            add_driver(part, "sum", sources[:TERMS], factors[:TERMS], [])
            sources, factors = [*sources[TERMS:], part], [*factors[TERMS:], 1.0]
        properties[name] = property_of(name)
        add_driver(properties[name], value["operation"], sources, factors, value["curve"])


if __name__ == "__main__":
    sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))  # Blender does not add it
    from drivers import TERMS, add_driver

    main(*(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]))
    os._exit(0)  # bpy can hang on exit after Python drivers ran
