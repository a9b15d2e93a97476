"""Runs inside Blender: key the curves of curves.csv, which lies beside this script with curves.json.

    blender hero.blend --python key_in_blender.py                  or open it in Blender's text editor and press Run
    blender hero.blend --python key_in_blender.py -- "NAME"        onto the object NAME

Each curve goes to the first of these that is there: the custom property of its name on the object NAME (where none is given,
on `RIG controls`), a shape key of its name on that object or on any mesh. What finds no place becomes a custom property of
a new object `RIG controls`. A rigid motion that was taken off the meshes is keyed on an empty, `RIG motion`: parent the
head to it. Curves replace what was keyed there before; between keys they are straight lines.
"""

import csv
import json
import math
import os
import sys
from typing import Any

import bpy

METRES = 0.001  # per mm


def main(folder: str, wanted: str) -> None:
    """Read the curves, key each on its control, and set the scene's frames."""
    with open(os.path.join(folder, "curves.json"), encoding="utf-8") as file:
        facts = json.load(file)
    with open(os.path.join(folder, "curves.csv"), encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    columns = {name: [float(row[place]) for row in rows[1:]] for place, name in enumerate(map(own_name, rows[0]))}
    frames = columns["frame"]
    scene = bpy.context.scene
    scene.render.fps = max(1, round(facts["fps"]))
    scene.render.fps_base = scene.render.fps / facts["fps"]
    scene.frame_start, scene.frame_end = int(frames[0]), int(frames[-1])
    places = places_of(facts, wanted)
    row_of = {int(frame): row for row, frame in enumerate(frames)}
    for control in facts["controls"]:
        keys = facts.get("keys", {}).get(control["name"], frames)
        values = columns[control["name"]]
        key(*places[control["name"]], keys, [values[row_of[int(frame)]] for frame in keys])
    if "motion" in facts:
        key_motion(facts, columns, frames)
    print(f"{facts['rig']}: {len(facts['controls'])} curves of {len(frames)} frames keyed")


def own_name(column: str) -> str:
    """A column's name without the apostrophe that keeps spreadsheets from taking it for a formula."""
    return column[1:] if column[:1] == "'" and column[1:2] in ("=", "+", "-", "@") else column


def places_of(facts: dict, target_name: str) -> dict:
    """For each control the datablock and the path that it is keyed on."""
    name = target_name or f"{facts['rig']} controls"
    target = bpy.data.objects.get(name)
    if target_name and target is None:
        raise SystemExit(f"there is no object named '{target_name}'")
    meshes = [item for item in bpy.data.objects if item.type == "MESH" and item.data.shape_keys]
    meshes.sort(key=lambda item: item is not target)
    places = {}
    for control in facts["controls"]:
        path = f'["{bpy.utils.escape_identifier(control["name"])}"]'
        keyed = next((item.data.shape_keys for item in meshes if control["name"] in item.data.shape_keys.key_blocks), None)
        if target is not None and control["name"] in target.keys():
            places[control["name"]] = target, path
        elif keyed is not None:
            places[control["name"]] = keyed, f"key_blocks{path}.value"
            block = keyed.key_blocks[control["name"]]
            block.slider_min, block.slider_max = (
                min(block.slider_min, control["lower"]),
                max(block.slider_max, control["upper"]),
            )
        else:
            target = target or added(f"{facts['rig']} controls")
            target[control["name"]] = float(control["neutral"])
            target.id_properties_ui(control["name"]).update(min=control["lower"], max=control["upper"])
            places[control["name"]] = target, path
    return places


def added(name: str) -> bpy.types.Object:
    """A new empty in the scene."""
    empty = bpy.data.objects.new(name, None)
    bpy.context.scene.collection.objects.link(empty)
    return empty


def key(owner: Any, path: str, frames: list, values: list, index: int = -1) -> None:
    """Replace a curve by straight lines between keys."""
    owner.keyframe_insert(path, index=index, frame=frames[0])  # makes the action, the slot and the curve
    curve = next(c for c in curves_of(owner) if c.data_path == path and (index < 0 or c.array_index == index))
    curve.keyframe_points.clear()
    curve.keyframe_points.add(len(frames))
    pairs = [number for pair in zip(frames, values) for number in pair]
    curve.keyframe_points.foreach_set("co", pairs)
    linear = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value
    curve.keyframe_points.foreach_set("interpolation", [linear] * len(frames))
    curve.update()


def curves_of(owner: Any) -> Any:
    """The curves of an owner's action, in Blender before and since 5.0."""
    action = owner.animation_data.action
    if hasattr(action, "fcurves"):
        return action.fcurves
    return action.layers[0].strips[0].channelbag(owner.animation_data.action_slot).fcurves


def key_motion(facts: dict, columns: dict, frames: list) -> None:
    """Key the rigid motion, from y up to z up and from mm to metres."""
    name = f"{facts['rig']} motion"
    empty = bpy.data.objects.get(name) or added(name)
    moves, turns = facts["motion"][:3], facts["motion"][3:]
    # Blender's x, y, z are the file's x, -z, y. Turning about x, y, z in this order there is x, z, -y here: order XZY.
    empty.rotation_mode = "XZY"
    for index, name, sign in ((0, moves[0], 1), (1, moves[2], -1), (2, moves[1], 1)):
        key(empty, "location", frames, [sign * METRES * value for value in columns[name]], index)
    for index, name, sign in ((0, turns[0], 1), (1, turns[2], -1), (2, turns[1], 1)):
        key(empty, "rotation_euler", frames, [sign * math.radians(value) for value in columns[name]], index)


if __name__ == "__main__":
    try:
        here = os.path.dirname(os.path.abspath(__file__))
    except NameError:
        here = ""
    if not os.path.isfile(os.path.join(here, "curves.json")):  # the text editor's path is within the .blend
        here = os.path.dirname(bpy.path.abspath(bpy.context.space_data.text.filepath))
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    main(here, arguments[0] if arguments else "")
