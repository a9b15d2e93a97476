"""Small .blend files, made by Blender for the tests; tests that need it are skipped where there is none."""

import os
import subprocess
from pathlib import Path

import pytest

from riginv.errors import InputError
from rigs.blender.interpreter import find_interpreter


def blender() -> str:
    try:
        return find_interpreter()
    except InputError as error:
        pytest.skip(str(error))


def make_blend(path: Path, script: str) -> Path:
    """Run a script in an empty Blender and save what it made."""
    program = (
        "import bpy, math\nbpy.ops.wm.read_factory_settings(use_empty=True)\nscene = bpy.context.scene\n"
        f"{BITS}\n{script}\nbpy.ops.wm.save_as_mainfile(filepath={str(path)!r}, copy=True)\nimport os\nos._exit(0)\n"
    )
    (path.parent / "make.py").write_text(program)
    environment = {**os.environ, "TMPDIR": str(path.parent)}
    command = [blender(), str(path.parent / "make.py")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert done.returncode == 0, done.stderr
    return path


BITS = """
def add(name, data=None):
    thing = bpy.data.objects.new(name, data)
    scene.collection.objects.link(thing)
    return thing

def cube(name="cube"):
    mesh = bpy.data.meshes.new(name)
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0, 2)]
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh.from_pydata(corners, [], sides)
    return add(name, mesh)

def shape(thing, name, move, only=lambda co: True):
    if not thing.data.shape_keys:
        thing.shape_key_add(name="Basis")
    key = thing.shape_key_add(name=name, from_mix=False)
    for point in key.data:
        if only(point.co):
            point.co = [a + b for a, b in zip(point.co, move)]
    return key

def drive(owner, path, source, source_path, expression="v"):
    curve = owner.driver_add(path)
    driver = curve.driver
    driver.type = "SCRIPTED"
    variable = driver.variables.new()
    variable.name = "v"
    target = variable.targets[0]
    target.id_type = source.id_type
    target.id, target.data_path = source, source_path
    driver.expression = expression
    return curve

def bones(name, *heads_and_tails):
    armature = add(name, bpy.data.armatures.new(name))
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    parent = None
    for number, (head, tail) in enumerate(heads_and_tails):
        bone = armature.data.edit_bones.new(f"bone{number}")
        bone.head, bone.tail, bone.parent = head, tail, parent
        parent = bone
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature
"""
