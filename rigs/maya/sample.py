"""Sample poses of a Maya rig as a table of pairs; runs in Maya's Python with the standard library only.

    mayapy sample.py --scene face.ma --mesh head_geo --controls "ctrl_*" --poses 10000 --most 20 --out pairs

Controls are the numeric attributes that an animator can key (keyable, unlocked, driven by nothing) on the nodes that
`--controls` names; `NODE.ATTRIBUTE` names single ones. Limits are those of the attribute or of the transform; where there are
none, 45 degrees or 10 mm each way, or 0 to 1. `--bounds "*.jaw=0:0.8"` overrides them. The folder that is written holds the
.npy files that `rigs.blender.sample` describes: vertices in world space, mm, y up.
"""

import argparse
import fnmatch
import os
import random
import struct
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence

DTYPES = {"<f4": "f", "<i4": "i"}
NUMBERS = ("double", "float", "doubleAngle", "doubleLinear")
UNLIMITED = {"doubleAngle": (-45.0, 45.0), "doubleLinear": (-1.0, 1.0)}  # degrees, cm


class NpyFile:
    """An .npy file, written row by row."""

    def __init__(self, path: str, dtype: str, shape: tuple) -> None:
        self.file, self.dtype, self.remaining = open(path, "wb"), dtype, shape[0]
        header = f"{{'descr': {dtype!r}, 'fortran_order': False, 'shape': {tuple(shape)!r}, }}"
        header += " " * (-(len(header) + 11) % 64) + "\n"
        self.file.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode("latin1"))

    def write(self, values: Sequence) -> None:
        """Write a row: a flat sequence of numbers, or a text."""
        if self.dtype.startswith("<U"):
            data = values.encode("utf-32-le")
            data += b"\0" * (4 * int(self.dtype[2:]) - len(data))
        else:
            data = struct.pack(f"<{len(values)}{DTYPES[self.dtype]}", *values)
        self.file.write(data)
        self.remaining -= 1

    def close(self) -> None:
        """End the file; raises ValueError where rows are missing."""
        self.file.close()
        if self.remaining:
            raise ValueError(f"{self.remaining} rows are missing")


def write_npy(path: str, dtype: str, shape: tuple, rows: Iterable) -> None:
    """A whole .npy file."""
    file = NpyFile(path, dtype, shape)
    for row in rows:
        file.write(row)
    file.close()


def draw_poses(limits: list, most: int, count: int, seed: int) -> Iterator[list]:
    """The paper's random poses: a uniform number of controls, up to `most`, get uniform values; the others are neutral.

    limits: (lower, upper, neutral) of each control.
    """
    generator = random.Random(seed)
    for _ in range(count):
        pose = [neutral for _, _, neutral in limits]
        for number in generator.sample(range(len(limits)), generator.randint(1, most)):
            pose[number] = generator.uniform(*limits[number][:2])
        yield pose


def write_table(
    folder: str, names: list, limits: list, rest: list, faces: list, poses: Iterable, evaluate: Callable[[list], list]
) -> None:
    """Write all arrays; `evaluate` maps a pose to the vertices as one flat list, mm."""
    os.makedirs(folder)
    poses, width = list(poses), max(len(name) for name in names)

    def path(name: str) -> str:
        return os.path.join(folder, name + ".npy")

    write_npy(path("control_names"), f"<U{width}", (len(names),), names)
    for index, name in enumerate(("lower", "upper", "neutral")):
        write_npy(path(name), "<f4", (len(names),), [[limit[index]] for limit in limits])
    write_npy(path("rest_vertices"), "<f4", (len(rest) // 3, 3), [rest[i : i + 3] for i in range(0, len(rest), 3)])
    write_npy(path("faces"), "<i4", (len(faces) // 3, 3), [faces[i : i + 3] for i in range(0, len(faces), 3)])
    write_npy(path("controls"), "<f4", (len(poses), len(names)), poses)
    vertices = NpyFile(path("vertices"), "<f4", (len(poses), len(rest) // 3, 3))
    for number, pose in enumerate(poses, start=1):
        vertices.write(evaluate(pose))
        if number % 100 == 0:
            print(f"{number} of {len(poses)} poses", file=sys.stderr)
    vertices.close()


def bounded(name: str, limits: tuple, bounds: list) -> tuple:
    """Limits of a control, overridden by GLOB=LOWER:UPPER of the command line."""
    lower, upper, neutral = limits
    for bound in bounds:
        pattern, _, values = bound.rpartition("=")
        if fnmatch.fnmatchcase(name, pattern):
            lower, upper = (float(value) for value in values.split(":"))
    if not lower <= neutral <= upper or lower == upper:
        raise SystemExit(f"{name}: neutral at {neutral:g}, outside its range {lower:g} to {upper:g}; mend it with --bounds")
    return lower, upper, neutral


class MayaRig:
    """A mesh in a Maya scene, and the attributes that move it."""

    def __init__(self, scene: str, mesh: str, patterns: list, bounds: list) -> None:
        import maya.standalone

        maya.standalone.initialize(name="python")
        import maya.api.OpenMaya as api
        from maya import cmds

        self.api, self.cmds = api, cmds
        cmds.file(scene, open=True, force=True, executeScriptNodes=False)
        selection = api.MSelectionList()
        selection.add(mesh)
        path = selection.getDagPath(0)
        path.extendToShape()
        self.mesh = api.MFnMesh(path)
        self.y_up = cmds.upAxis(query=True, axis=True) == "y"
        self.names = [name for pattern in patterns for name in self.find(pattern)]
        if not self.names:
            raise SystemExit(f"{scene}: nothing keyable and free fits {' '.join(patterns)}")
        self.limits = [bounded(name, self.limits_of(name), bounds) for name in self.names]

    def find(self, pattern: str) -> Iterator[str]:
        """Names of free attributes."""
        nodes, _, attribute = pattern.partition(".")
        for node in self.cmds.ls(nodes) or []:
            for name in self.cmds.listAttr(node, keyable=True, unlocked=True, scalar=True) or []:
                full = node + "." + name
                kind = self.cmds.getAttr(full, type=True)
                free = not self.cmds.connectionInfo(full, isDestination=True)
                if free and kind in NUMBERS and fnmatch.fnmatchcase(name, attribute or "*"):
                    yield full

    def limits_of(self, full: str) -> tuple:
        """Lower, upper and neutral value of an attribute."""
        node, name = full.rsplit(".", 1)
        cmds = self.cmds
        neutral = (cmds.attributeQuery(name, node=node, listDefault=True) or [cmds.getAttr(full)])[0]
        limits = list(UNLIMITED.get(cmds.getAttr(full, type=True), (min(0.0, neutral), max(1.0, neutral))))
        if name[:-1] in ("translate", "rotate", "scale") and cmds.objectType(node, isAType="transform"):
            flag = name[0] + name[-1].lower()  # tx, ry...
            enabled = cmds.transformLimits(node, query=True, **{"e" + flag: True})
            values = cmds.transformLimits(node, query=True, **{flag: True})
            limits = [value if on else limit for on, value, limit in zip(enabled, values, limits)]
        for index, side in enumerate(("min", "max")):
            for query in (side, "soft" + side.capitalize()):
                if cmds.attributeQuery(name, node=node, **{query + "Exists": True}):
                    limits[index] = cmds.attributeQuery(name, node=node, **{query: True})[0]
                    break
        return limits[0], limits[1], neutral

    def vertices(self, pose: list) -> list:
        """The vertices of a pose as one flat list, mm, y up."""
        for name, value in zip(self.names, pose):
            self.cmds.setAttr(name, value)
        flat = []
        for point in self.mesh.getPoints(self.api.MSpace.kWorld):  # cm, for any unit of the scene
            x, y, z = 10 * point.x, 10 * point.y, 10 * point.z
            flat += (x, y, z) if self.y_up else (x, z, -y)
        return flat

    def faces(self) -> list:
        """The triangles as one flat list."""
        return list(self.mesh.getTriangles()[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True)
    parser.add_argument("--mesh", required=True, help="the transform or the shape of the mesh")
    parser.add_argument("--controls", required=True, action="append", help="NODES or NODES.ATTRIBUTES, with wildcards")
    parser.add_argument("--bounds", default=[], action="append", help="GLOB=LOWER:UPPER")
    parser.add_argument("--poses", type=int, default=10000)
    parser.add_argument("--most", type=int, help="controls that leave neutral at a time, at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", required=True, help="a folder that does not exist yet")
    given = parser.parse_args()
    if os.path.exists(given.out):
        raise SystemExit(f"{given.out}: it is there already; give another name")
    rig = MayaRig(given.scene, given.mesh, given.controls, given.bounds)
    most = min(given.most or len(rig.names), len(rig.names))
    rest = rig.vertices([neutral for _, _, neutral in rig.limits])
    poses = draw_poses(rig.limits, most, given.poses, given.seed)
    write_table(given.out, rig.names, rig.limits, rest, rig.faces(), poses, rig.vertices)
    print(f"{given.out}: {given.poses} poses of {len(rig.names)} controls")


if __name__ == "__main__":
    main()
