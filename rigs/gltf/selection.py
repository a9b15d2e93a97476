"""Selection of meshes, for rigs and for clips."""

from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import NamedTuple

from riginv.errors import InputError, listed, printable
from rigs.gltf.container import GltfFile
from rigs.gltf.scene import Scene
from rigs.gltf.targets import target_count


class MeshName(NamedTuple):
    """Names of a mesh: that of its node, unique in the file, and its own, which may be empty."""

    node: str
    mesh: str

    @property
    def shown(self) -> str:
        """The name for messages: the mesh's own where its node has none."""
        return printable(self.mesh if self.mesh and self.node.startswith("node_") else self.node)


def mesh_nodes(file: GltfFile, scene: Scene) -> list[int]:
    """Nodes of the scene that have a mesh."""
    nodes = file.document["nodes"]
    shown = [number for number, node in enumerate(nodes) if "mesh" in node and scene.shown[number]]
    for number in shown:
        file.item("meshes", nodes[number]["mesh"], f"node '{scene.names[number]}'")
    return shown


def mesh_name(file: GltfFile, scene: Scene, node: int) -> MeshName:
    return MeshName(scene.names[node], file.document["meshes"][file.document["nodes"][node]["mesh"]].get("name", ""))


def mesh_names(file: GltfFile, scene: Scene, nodes: Iterable[int]) -> tuple[MeshName, ...]:
    """Names of the meshes of nodes, each node once."""
    return tuple(mesh_name(file, scene, node) for node in dict.fromkeys(nodes))


def named_meshes(file: GltfFile, scene: Scene, globs: Sequence[str], key: str) -> list[int]:
    """Nodes whose meshes match names or globs, in the order of the file; all nodes with meshes where globs is empty.

    Args:
        key: of the config, for messages.

    Raises:
        InputError: a glob matches no mesh.
    """
    nodes = mesh_nodes(file, scene)
    if not globs:
        return nodes
    names, found = {node: mesh_name(file, scene, node) for node in nodes}, set[int]()
    for glob in globs:
        matching = _matching(names, glob)
        if not matching:
            raise InputError(
                f"{file.path}: {key} names {glob!r}, no mesh is called so; its meshes are: {listed_meshes(names.values())}"
            )
        found |= matching
    return [node for node in nodes if node in found]


def _matching(names: Mapping[int, MeshName], glob: str) -> set[int]:
    """Nodes of an exact name, else of a glob: names may contain brackets and asterisks."""
    exact = {node for node, name in names.items() if glob in name}
    return exact or {node for node, name in names.items() if any(fnmatchcase(one, glob) for one in name)}


def rig_meshes(file: GltfFile, scene: Scene, include: list[str], exclude: list[str], joints: bool) -> list[int]:
    """Nodes whose meshes make a rig: those that match `include`, else all deformable ones.

    Args:
        include, exclude: names or globs of nodes or meshes.
        joints: count skinned meshes as deformable.

    Raises:
        InputError: no mesh remains.
    """
    names = {node: mesh_name(file, scene, node) for node in mesh_nodes(file, scene)}
    gone = set[int]().union(*(_matching(names, glob) for glob in exclude))
    kept = [node for node in named_meshes(file, scene, include, "rig.include") if node not in gone]
    known = listed_meshes(names.values())
    if not kept:
        raise InputError(f"{file.path}: no mesh is left for the rig; its meshes are: {known}; see rig.include and rig.exclude")
    if include:
        return kept
    moving = with_targets(file, kept) if not joints else with_targets_or_skin(file, kept)
    if not moving:
        hint = "" if joints or not file.document.get("skins") else "; rig.joints=true makes controls of its joints"
        raise InputError(f"{file.path}: no morph targets in any of its meshes ({known}): nothing moves{hint}")
    return moving


def with_targets(file: GltfFile, nodes: list[int]) -> list[int]:
    mesh_of = {node: file.document["nodes"][node]["mesh"] for node in nodes}
    counts = {mesh: target_count(file, mesh) for mesh in set(mesh_of.values())}
    return [node for node in nodes if counts[mesh_of[node]]]


def with_targets_or_skin(file: GltfFile, nodes: list[int]) -> list[int]:
    moved = set(with_targets(file, nodes))
    return [node for node in nodes if node in moved or "skin" in file.document["nodes"][node]]


def listed_meshes(names: Iterable[MeshName]) -> str:
    """The names of meshes for a message, each once, sorted."""
    return listed(sorted({name.shown for name in names}))
