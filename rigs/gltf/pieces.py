"""The meshes of an avatar as pieces: vertices that share their data, with the triangles and the targets that use them."""

from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from riginv.errors import InputError
from rigs.gltf.accessors import MOST_NUMBERS, count_of, read_numbers
from rigs.gltf.container import COMPRESSED, GltfFile, compression_error
from rigs.gltf.scene import Scene
from rigs.gltf.skins import Carriers, carriers
from rigs.gltf.targets import mesh_label, target_count, target_names
from rigs.gltf.triangles import read_triangles

MOST_PRIMITIVES = 10_000
PLACING = ("POSITION", "JOINTS_", "WEIGHTS_")  # attributes that place a vertex; the others only colour it


@dataclass(frozen=True)
class Piece:
    """Vertices of one node that share their data, used by one primitive or several.

    Attributes:
        label: what messages call it.
        node, mesh: their numbers.
        attributes: the accessors that place the vertices, by attribute.
        targets: the accessor of each morph target's deltas, by the target's name; None for one that does not move the piece.
        start, count: its vertices among those of all pieces.
        primitives: its primitives in the document.
    """

    label: str
    node: int
    mesh: int
    attributes: dict[str, int]
    targets: dict[str, int | None]
    start: int
    count: int
    primitives: list[dict]

    @property
    def vertices(self) -> slice:
        return slice(self.start, self.start + self.count)

    def positions(self, file: GltfFile) -> np.ndarray:
        """Positions `(vertex, 3)`, in the primitive's own coordinates."""
        return read_numbers(file, self.attributes["POSITION"], "VEC3", f"POSITION of {self.label}")

    def deltas(self, file: GltfFile) -> Iterator[tuple[str, np.ndarray]]:
        """The name and the deltas `(vertex, 3)` of each target that moves the piece, in the primitive's own coordinates."""
        for name, accessor in self.targets.items():
            if accessor is not None:
                yield name, read_numbers(file, accessor, "VEC3", f"target '{name}' of {self.label}")

    def carriers(self, file: GltfFile, scene: Scene) -> Carriers:
        return carriers(file, scene, self.node, self.attributes, self.count, self.label)

    def triangles(self, file: GltfFile) -> np.ndarray:
        """Triangles `(face, 3)`, indices of the piece's own vertices."""
        return np.concatenate([read_triangles(file, primitive, self.count, self.label) for primitive in self.primitives])


def chosen_nodes(file: GltfFile, scene: Scene, include: list[str], exclude: list[str], joints: bool) -> list[int]:
    """The nodes whose meshes make the rig: those of the scene that globs name, or without any all that can move.

    Args:
        include, exclude: globs of the names of nodes or meshes; without `include` meshes that never move are left out.
        joints: whether a skin counts as moving.

    Raises:
        InputError: nothing is left.
    """
    nodes = file.document["nodes"]
    shown = [number for number, node in enumerate(nodes) if "mesh" in node and scene.shown[number]]
    for number in shown:
        file.item("meshes", nodes[number]["mesh"], f"node '{scene.names[number]}'")

    def named(number: int, globs: list[str]) -> bool:
        names = (scene.names[number], file.document["meshes"][nodes[number]["mesh"]].get("name", ""))
        return any(fnmatchcase(name, glob) for name in names for glob in globs)

    known = ", ".join(sorted({scene.names[number] for number in shown})[:12]) or "none"
    for glob in include:
        if not any(named(number, [glob]) for number in shown):
            raise InputError(f"{file.path}: rig.include names {glob!r}, no mesh is called so; its meshes are: {known}")
    kept = [number for number in shown if (not include or named(number, include)) and not named(number, exclude)]
    if not kept:
        raise InputError(f"{file.path}: no mesh is left for the rig; its meshes are: {known}; see rig.include and rig.exclude")
    if include:
        return kept
    moving = [n for n in kept if target_count(file, nodes[n]["mesh"]) or (joints and "skin" in nodes[n])]
    if not moving:
        hint = "" if joints or not file.document.get("skins") else "; rig.joints=true makes controls of its joints"
        raise InputError(f"{file.path}: no morph targets in any of its meshes ({known}): nothing moves{hint}")
    return moving


def pieces(file: GltfFile, nodes: list[int]) -> list[Piece]:
    """The pieces of the meshes of nodes, in the order of the file.

    Raises:
        InputError: vertices and targets do not fit each other, or there is more than could be meant.
    """
    names = target_names(file, sorted({file.document["nodes"][node]["mesh"] for node in nodes}))
    found: dict[tuple, Piece] = {}
    start = corners = 0
    for seen, (node, mesh, number, primitive) in enumerate(_primitives(file, nodes)):
        label = f"{mesh_label(file, mesh)}, primitive {number}"
        attributes = {name: accessor for name, accessor in primitive["attributes"].items() if name.startswith(PLACING)}
        targets = {name: target.get("POSITION") for name, target in zip(names[mesh], primitive.get("targets", []))}
        if "POSITION" not in attributes:
            raise InputError(f"{file.path}: {label} has no POSITION: the file is damaged; export it again")
        _refuse_compressed(file, primitive, attributes["POSITION"])
        count = count_of(file, attributes["POSITION"], f"POSITION of {label}")
        corners += count_of(file, primitive["indices"], f"indices of {label}") if "indices" in primitive else count
        key = (node, tuple(sorted(attributes.items())), tuple(targets.values()))
        if key in found:  # primitives that differ in their material alone
            found[key].primitives.append(primitive)
        else:
            _check_counts(file, targets, count, label)
            found[key] = Piece(label, node, mesh, attributes, targets, start, count, [primitive])
            start += count
        if max(3 * start * (1 + len(targets)), corners) > MOST_NUMBERS or seen >= MOST_PRIMITIVES:
            raise InputError(
                f"{file.path}: {start} vertices with {len(targets)} morph targets and {corners} corners in {seen + 1} "
                f"primitives are more than can be meant: choose meshes with rig.include=[NAME]"
            )
    if not found:
        raise InputError(f"{file.path}: its meshes have no primitives, so there is no vertex: export it again")
    return list(found.values())


def _check_counts(file: GltfFile, targets: dict[str, int | None], count: int, label: str) -> None:
    for name, accessor in targets.items():
        if accessor is not None and (moved := count_of(file, accessor, f"target '{name}' of {label}")) != count:
            raise InputError(
                f"{file.path}: target '{name}' of {label} moves {moved} vertices, the primitive has {count}: export it again"
            )


def _primitives(file: GltfFile, nodes: list[int]) -> Iterator[tuple[int, int, int, dict]]:
    for node in nodes:
        mesh = file.document["nodes"][node]["mesh"]
        for number, primitive in enumerate(file.document["meshes"][mesh]["primitives"]):
            yield node, mesh, number, primitive


def _refuse_compressed(file: GltfFile, primitive: dict, position: int) -> None:
    """Compressed vertices may come with plain ones besides; without these nothing can be read."""
    for name in COMPRESSED:
        if name in primitive.get("extensions", {}) and "bufferView" not in file.item("accessors", position, "POSITION"):
            raise compression_error(file.path, name)
