"""Inside Blender: the controls of a .blend: custom properties that drive, undriven shape keys, free bones."""

import math
import re
from typing import Any

import bpy

WIDEST = 1000.0  # limits beyond it are unset: Blender's defaults are 1e4 or 3e38
UNLIMITED_DEGREES = 45.0  # each way, for rotations without limits
UNLIMITED_LENGTHS = 0.1  # each way, as a fraction of the bone's length, for locations without limits
AXES = "xyz"
# Constraints that override channels of a bone.
OVERRULE = {
    "COPY_TRANSFORMS": ("location", "rotation", "scale"),
    "ARMATURE": ("location", "rotation", "scale"),
    "COPY_ROTATION": ("rotation",),
    "DAMPED_TRACK": ("rotation",),
    "TRACK_TO": ("rotation",),
    "LOCKED_TRACK": ("rotation",),
    "COPY_LOCATION": ("location",),
    "COPY_SCALE": ("scale",),
}
Driven = set[tuple[bpy.types.ID, str, int | None]]  # datablock, path and index of driven properties


class Control:
    """A control: `owner.key`, or `owner[key]` of a custom property, or the element `index` of it."""

    def __init__(
        self,
        name: str,
        datablock: bpy.types.ID,
        owner: Any,
        key: str,
        index: int | None,
        limits: tuple[float, float],
        neutral: float,
        unit: str = "",
        factor: float = 1.0,
        custom: bool = False,
    ) -> None:
        self.name, self.datablock, self.unit = name, datablock, unit
        self.owner, self.key, self.index, self.custom = owner, key, index, custom
        self.lower, self.upper = limits
        self.neutral = min(max(neutral, self.lower), self.upper)
        self.factor = factor  # from the unit to what Blender stores
        self.value = None

    def set(self, value: float) -> bool:
        """Set it, and return whether it changed."""
        if value == self.value:
            return False
        self.value, stored = value, value * self.factor
        if self.custom:
            vector = self.owner[self.key]
            old = vector if self.index is None else vector[self.index]
            stored = stored if isinstance(old, float) else type(old)(round(stored))
        if self.index is not None:
            (self.owner[self.key] if self.custom else getattr(self.owner, self.key))[self.index] = stored
        elif self.custom:
            self.owner[self.key] = stored
        else:
            setattr(self.owner, self.key, stored)
        return True


def discover(mesh: bpy.types.Object, datablocks: list[bpy.types.ID]) -> dict[str, Control]:
    """Controls of a mesh by name, from all datablocks that it depends on."""
    curves = [(datablock, curve) for datablock in datablocks for curve in drivers_of(datablock)]
    driven = {(datablock, curve.data_path, curve.array_index) for datablock, curve in curves}
    driven |= {(datablock, path, None) for datablock, path, _ in driven}
    found = [*properties_that_drive(curves, driven), *shape_keys(mesh, datablocks, driven)]
    for thing in datablocks:
        if isinstance(thing, bpy.types.Object) and thing.pose:
            found += [control for bone in thing.pose.bones for control in free_channels(thing, bone, driven)]
    names = [control.name for control in found]
    for number, control in enumerate(found):
        if names.count(control.name) > 1:
            names[number] = f"{control.datablock.name}/{control.name}"
    for number, control in enumerate(found):
        control.name = names[number] if names.count(names[number]) == 1 else f"{names[number]}#{number}"
    return {control.name: control for control in found}


def drivers_of(datablock: bpy.types.ID) -> list[bpy.types.FCurve]:
    animation = getattr(datablock, "animation_data", None)
    return list(animation.drivers) if animation else []


def properties_that_drive(curves: list[tuple[bpy.types.ID, bpy.types.FCurve]], driven: Driven) -> list[Control]:
    """Custom properties that drivers read and none drives, in the order of their owners' properties."""
    found = {}
    targets = [target for _, curve in curves for variable in curve.driver.variables for target in variable.targets]
    for target in targets:
        match = re.fullmatch(r'(.*?)\.?\["((?:[^"\\]|\\.)+)"\](?:\[(\d+)\])?', target.data_path or "")
        datablock = target.id
        if not match or datablock is None:
            continue
        prefix, key, index = match[1], re.sub(r"\\(.)", r"\1", match[2]), int(match[3]) if match[3] else None
        path = target.data_path
        if {(datablock, path, index), (datablock, path, None), (datablock, path.rpartition("[")[0], index)} & driven:
            continue
        try:
            owner = datablock.path_resolve(prefix) if prefix else datablock
        except ValueError:
            continue
        if isinstance(owner, bpy.types.bpy_struct) and key in owner.keys():
            order = (datablock.name, prefix, list(owner.keys()).index(key), index or 0)
            found[order] = custom_property(datablock, owner, key, index)
    return [control for _, control in sorted(found.items(), key=lambda item: item[0]) if control]


def custom_property(datablock: bpy.types.ID, owner: Any, key: str, index: int | None) -> Control | None:
    """A custom property as a control, with the limits of its slider; None where it is not a number."""
    value = owner[key] if index is None else owner[key][index]
    if not isinstance(value, (bool, int, float)):
        return None
    ui = {} if isinstance(value, bool) else owner.id_properties_ui(key).as_dict()
    lower, upper = (ui.get(f"soft_{side}", ui.get(side, unset)) for side, unset in (("min", 0.0), ("max", 1.0)))
    default = ui.get("default", float(value))
    default = default[index] if index is not None and hasattr(default, "__len__") else default
    lower = lower if abs(lower) <= WIDEST else min(0.0, default)
    upper = upper if abs(upper) <= WIDEST else max(1.0, default)
    name = key if index is None else f"{key}[{index}]"
    factor, unit = (math.radians(1), "deg") if ui.get("subtype") == "ANGLE" else (1.0, "")
    return Control(
        name, datablock, owner, key, index, (lower / factor, upper / factor), default / factor, unit, factor, custom=True
    )


def shape_keys(mesh: bpy.types.Object, datablocks: list[bpy.types.ID], driven: Driven) -> list[Control]:
    """Shape keys that no driver moves, those of the mesh first."""
    found = []
    for keys in sorted(
        (each for each in datablocks if isinstance(each, bpy.types.Key)), key=lambda each: each.user != mesh.data
    ):
        if not keys.use_relative:
            continue
        for block in keys.key_blocks:
            free = (keys, f'key_blocks["{bpy.utils.escape_identifier(block.name)}"].value', None) not in driven
            if free and block != keys.reference_key and not block.mute and block.slider_min < block.slider_max:
                found.append(Control(block.name, keys, block, "value", None, (block.slider_min, block.slider_max), 0.0))
    return found


def free_channels(armature: bpy.types.Object, bone: bpy.types.PoseBone, driven: Driven) -> list[Control]:
    """Channels of a visible bone that are not locked, driven or overridden."""
    collections = bone.bone.collections
    if bone.bone.hide or (len(collections) and not any(collection.is_visible_effectively for collection in collections)):
        return []
    active = [constraint for constraint in bone.constraints if not constraint.mute and constraint.influence == 1]
    closed = {channel for constraint in active for channel in OVERRULE.get(constraint.type, ())}
    if bone.bone.use_connect and bone.parent:
        closed.add("location")
    base = f'pose.bones["{bpy.utils.escape_identifier(bone.name)}"]'
    if any((armature, f"{base}.{path}", None) in driven for path in ("rotation_quaternion", "rotation_axis_angle")):
        closed.add("rotation")
    elif bone.rotation_mode in ("QUATERNION", "AXIS_ANGLE") and "rotation" not in closed:
        bone.rotation_mode = "XYZ"  # three free numbers instead of four that depend on each other
    mm = bpy.context.scene.unit_settings.scale_length * 1000
    reach = UNLIMITED_LENGTHS * bone.bone.length * mm
    kinds = [
        ("location", "location", bone.lock_location, "mm", 1 / mm, (-reach, reach), 0.0),
        (
            "rotation",
            "rotation_euler",
            bone.lock_rotation,
            "deg",
            math.radians(1),
            (-UNLIMITED_DEGREES, UNLIMITED_DEGREES),
            0.0,
        ),
        ("scale", "scale", bone.lock_scale, "", 1.0, (1.0, 1.0), 1.0),  # only where something limits it
    ]
    channels = []
    for kind, path, locks, unit, factor, unlimited, neutral in kinds:
        for index in range(3):
            if kind in closed or locks[index] or (armature, f"{base}.{path}", index) in driven:
                continue
            lower, upper = limits(active, kind, index, factor, unlimited)
            if lower < upper:
                name = f"{bone.name}.{kind}_{AXES[index]}"
                channels.append(Control(name, armature, bone, path, index, (lower, upper), neutral, unit, factor))
    return channels


def limits(constraints: list, kind: str, index: int, factor: float, unlimited: tuple[float, float]) -> tuple[float, float]:
    """The limits of a channel, in its unit, by the bone's Limit constraints."""
    lower, upper = unlimited
    for constraint in constraints:
        if constraint.type != f"LIMIT_{kind.upper()}" or constraint.owner_space != "LOCAL":
            continue
        axis = AXES[index]
        if kind == "rotation":
            low = high = getattr(constraint, f"use_limit_{axis}")
        else:
            low, high = getattr(constraint, f"use_min_{axis}"), getattr(constraint, f"use_max_{axis}")
        lower = getattr(constraint, f"min_{axis}") / factor if low else lower
        upper = getattr(constraint, f"max_{axis}") / factor if high else upper
    return lower, upper
