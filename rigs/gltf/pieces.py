"""The meshes of an avatar as pieces: vertices that share their data, with the triangles and the targets that use them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from riginv.errors import InputError
from rigs.gltf.accessors import MOST_NUMBERS, count_of, read_numbers
from rigs.gltf.container import COMPRESSED, GltfFile, compression_error
from rigs.gltf.scene import Scene
from rigs.gltf.skins import Binding, Carriers, binding
from rigs.gltf.targets import mesh_label, target_names
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

    def binding(self, file: GltfFile, scene: Scene) -> Binding:
        return binding(file, scene, self.node, self.attributes, self.count, self.label)

    def carriers(self, file: GltfFile, scene: Scene) -> Carriers:
        """What carries the vertices at rest."""
        return self.binding(file, scene).carriers(scene.world)

    def triangles(self, file: GltfFile) -> np.ndarray:
        """Triangles `(face, 3)`, indices of the piece's own vertices."""
        return np.concatenate([read_triangles(file, primitive, self.count, self.label) for primitive in self.primitives])


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
        moved = primitive.get("targets") or [{}] * len(names[mesh])
        targets = {name: target.get("POSITION") for name, target in zip(names[mesh], moved)}
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
