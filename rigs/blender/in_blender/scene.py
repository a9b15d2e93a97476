"""Inside Blender: a mesh of a .blend as a function of its controls."""

from typing import Any

import bpy
import numpy as np
from controls import discover, drivers_of
from mesh_choice import listing
from worker import RefusedError

ROOTS = ("Scene", "WindowManager", "WorkSpace", "Screen", "Library")  # datablocks that use everything
Answer = tuple[dict[str, Any], dict[str, np.ndarray]]


class BlenderScene:
    """The scene of a worker (docs/worker-protocol.md)."""

    def load(self, file: str, mesh: str | None = None, scripts: bool = False) -> Answer:
        """Open a file and choose its mesh."""
        try:
            bpy.ops.wm.open_mainfile(filepath=file, load_ui=False, use_scripts=scripts)
        except RuntimeError as error:
            raise RefusedError(f"{file}: Blender cannot open it: {' '.join(str(error).split())}") from None
        self.file = file
        self.mesh = choose_mesh(file, mesh)
        make_visible(self.mesh)
        datablocks = reached_from(self.mesh)
        for datablock in datablocks:
            animation = getattr(datablock, "animation_data", None)
            if animation:  # a rig is a function of its controls, not of time
                animation.action, animation.use_nla = None, False
        self.controls = discover(self.mesh, datablocks)
        if not self.controls:
            raise RefusedError(
                f"{file}: nothing moves the mesh '{self.mesh.name}': it has no custom property that drives, no undriven shape "
                f"key and no free bone"
            )
        self.graph = bpy.context.evaluated_depsgraph_get()
        self.mm = bpy.context.scene.unit_settings.scale_length * 1000
        self.rest = None
        self.rest, self.faces = self.pose({}), self.triangles()
        refuse_broken_drivers(file, datablocks, scripts)
        return {"mesh": self.mesh.name, "software": f"Blender {bpy.app.version_string}"}, {}

    def describe(self) -> Answer:
        """Controls, rest mesh and faces."""
        fields = ("name", "lower", "upper", "neutral", "unit")
        controls = [{field: getattr(control, field) for field in fields} for control in self.controls.values()]
        return {"mesh": self.mesh.name, "controls": controls}, {"rest_vertices": self.rest, "faces": self.faces}

    def evaluate(self, names: list[str], controls: np.ndarray) -> Answer:
        """The vertices of poses."""
        unknown = [name for name in names if name not in self.controls]
        if unknown:
            raise RefusedError(f"{self.file}: there is no control '{unknown[0]}'")
        vertices = np.empty((len(controls), *self.rest.shape), np.float32)
        for number, row in enumerate(controls.tolist()):
            vertices[number] = self.pose(dict(zip(names, row)))
        return {}, {"vertices": vertices}

    def pose(self, values: dict[str, float]) -> np.ndarray:
        """The vertices `(vertex, 3)`, mm, y up; controls without a value are neutral."""
        changed = {
            control.datablock for name, control in self.controls.items() if control.set(values.get(name, control.neutral))
        }
        for datablock in changed:
            datablock.update_tag()  # not automatic for custom properties
        self.graph.update()
        evaluated = self.mesh.evaluated_get(self.graph)
        mesh = evaluated.to_mesh()
        vertices = np.empty(len(mesh.vertices) * 3, np.float32)
        mesh.vertices.foreach_get("co", vertices)
        evaluated.to_mesh_clear()
        if self.rest is not None and vertices.size != self.rest.size:
            raise RefusedError(
                f"{self.file}: the mesh '{self.mesh.name}' has {vertices.size // 3} vertices in a pose and {len(self.rest)} at "
                f"rest: switch off the modifier that changes their number"
            )
        world = np.array(evaluated.matrix_world, np.float64)
        x, y, z = (vertices.reshape(-1, 3).astype(np.float64) @ world[:3, :3].T + world[:3, 3]).T * self.mm
        return np.stack([x, z, -y], axis=1).astype(np.float32)

    def triangles(self) -> np.ndarray:
        """The faces `(face, 3)` of the rest mesh, seen from outside counter-clockwise."""
        evaluated = self.mesh.evaluated_get(self.graph)
        mesh = evaluated.to_mesh()
        mesh.calc_loop_triangles()
        faces = np.empty(len(mesh.loop_triangles) * 3, np.int32)
        mesh.loop_triangles.foreach_get("vertices", faces)
        evaluated.to_mesh_clear()
        faces = faces.reshape(-1, 3)
        return faces[:, ::-1] if evaluated.matrix_world.determinant() < 0 else faces


def choose_mesh(file: str, name: str | None) -> bpy.types.Object:
    """The named mesh object, or the only one there is."""
    shown = {bone.custom_shape for thing in bpy.data.objects if thing.pose for bone in thing.pose.bones}
    meshes = {thing.name: thing for thing in bpy.data.objects if thing.type == "MESH" and thing not in shown}
    listed = listing([f"'{other}'" for other in meshes])
    if not meshes:
        raise RefusedError(f"{file}: it holds no mesh")
    if name is not None and name not in meshes:
        raise RefusedError(f"{file}: there is no mesh '{name}'; it has {listed}")
    if name is None and len(meshes) > 1:
        raise RefusedError(f"{file}: it holds {len(meshes)} meshes; choose one with rig.mesh=NAME: {listed}")
    return meshes[name] if name is not None else next(iter(meshes.values()))


def make_visible(thing: bpy.types.Object) -> None:
    """Show an object, since Blender evaluates only what a view layer shows."""
    scene, layer = bpy.context.scene, bpy.context.view_layer
    thing.hide_viewport = False
    if thing.name not in layer.objects or not thing.visible_get():
        if thing.name not in scene.collection.objects:
            scene.collection.objects.link(thing)
        thing.hide_set(False)


def reached_from(thing: bpy.types.ID) -> list[bpy.types.ID]:
    """All datablocks that a datablock uses, directly or through others: modifiers, parents, drivers, constraints."""
    uses = {}
    for used, users in bpy.data.user_map().items():
        for user in users:
            uses.setdefault(user, []).append(used)
    reached, waiting = [], [thing]
    while waiting:
        datablock = waiting.pop()
        if datablock in reached or type(datablock).__name__ in ROOTS:
            continue
        reached.append(datablock)
        waiting += uses.get(datablock, [])
    return reached


def refuse_broken_drivers(file: str, datablocks: list[bpy.types.ID], scripts: bool) -> None:
    """Raises RefusedError where drivers are invalid, mostly because they need Python, which only the user may allow."""
    drivers = [curve.driver for datablock in datablocks for curve in drivers_of(datablock)]
    broken = [driver for driver in drivers if driver.type == "SCRIPTED" and not driver.is_valid]
    if broken and not scripts:
        raise RefusedError(
            f"{file}: {len(broken)} drivers need Python that Blender does not run unasked, such as '{broken[0].expression}'; "
            f"if you trust the file, add rig.scripts=true"
        )
