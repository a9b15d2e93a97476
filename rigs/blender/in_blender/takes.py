"""Takes of FBX files, which Blender's importer loads as actions."""

import importlib
from collections.abc import Callable
from typing import Any, NamedTuple

import bpy
import numpy as np

IMPORTER = "io_scene_fbx.import_fbx"
DEFAULT_NAME = "the only take"


class Take(NamedTuple):
    """An animation stack of a file.

    Attributes:
        name: as the file has it.
        actions: what it does to each datablock: the datablock, its action and the action's slot.
    """

    name: str
    actions: list[tuple[bpy.types.ID, bpy.types.Action, Any]]

    def play(self) -> None:
        """Animate by this take alone."""
        stop()
        for datablock, action, slot in self.actions:
            datablock.animation_data.action = action
            if slot is not None:
                datablock.animation_data.action_slot = slot

    def key_times(self) -> np.ndarray:
        """Frames that have keys, `(key,)`, rising, as Blender counts them."""
        times = [np.empty(0, np.float32)]
        for action in {action for _, action, _ in self.actions}:
            for curve in curves_of(action):
                points = np.empty(2 * len(curve.keyframe_points), np.float32)
                curve.keyframe_points.foreach_get("co", points)
                times.append(points[::2])
        return np.unique(np.concatenate(times).astype(np.float64))


def import_takes(file: str) -> list[Take]:
    """Import a file into the scene.

    Returns:
        Its takes, in its order; all actions as one where the importer cannot be wrapped.
    """
    if not hasattr(bpy.ops.import_scene, "fbx") or "io_scene_fbx" not in bpy.context.preferences.addons:
        bpy.ops.preferences.addon_enable(module="io_scene_fbx")
    importer, takes = importlib.import_module(IMPORTER), []
    original = getattr(importer, "blen_read_animations", None)
    if original is not None:
        importer.blen_read_animations = _watching(original, importer, takes)
    try:
        bpy.ops.import_scene.fbx(filepath=file, anim_offset=0.0, use_image_search=False)
    finally:
        if original is not None:
            importer.blen_read_animations = original
    playing = _playing()
    return [take for take in takes if take.actions] or ([Take(DEFAULT_NAME, playing)] if playing else [])


def stop() -> None:
    """Remove all actions, so that nothing is animated."""
    for datablock, _, _ in _playing():
        datablock.animation_data.action = None


def curves_of(action: bpy.types.Action) -> list[bpy.types.FCurve]:
    """All curves of an action, in all layers and slots."""
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    return [curve for bag in bags for curve in bag.fcurves]


def _watching(original: Callable[..., None], importer: Any, takes: list[Take]) -> Callable[..., None]:
    """The importer's function that reads all stacks, called for each separately, so that the actions of each are known."""

    def read(stack_template: Any, layer_template: Any, stacks: dict[Any, Any], *rest: Any) -> None:
        for key, stack in stacks.items():
            stop()
            original(stack_template, layer_template, {key: stack}, *rest)
            name = importer.elem_name_ensure_class(stack[0][0], b"AnimStack")
            takes.append(Take(name, _playing()))

    return read


def _playing() -> list[tuple[bpy.types.ID, bpy.types.Action, Any]]:
    """The animated objects, and the action of each."""
    found = []
    for datablock in (*bpy.data.objects, *bpy.data.shape_keys, *bpy.data.materials, *bpy.data.cameras):
        animation = datablock.animation_data
        if animation and animation.action:
            found.append((datablock, animation.action, getattr(animation, "action_slot", None)))
    return found
