"""Submeshes: vertices with their own vertex data, and the triangles and morph targets that use them."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from riginv.errors import InputError
from rigs.gltf.accessors import MOST_NUMBERS, count_of, read_numbers
from rigs.gltf.container import COMPRESSED, GltfFile, compression_error
from rigs.gltf.scene import Scene
from rigs.gltf.skins import Binding, PosedBinding, binding
from rigs.gltf.targets import mesh_label, target_names
from rigs.gltf.triangles import read_triangles

MOST_PRIMITIVES = 10_000
GEOMETRIC = ("POSITION", "JOINTS_", "WEIGHTS_")  # attributes that affect positions


@dataclass(frozen=True)
class Submesh:
    """Vertices of one node, used by one or several primitives.

    Attributes:
        label: for messages.
        node, mesh: indices in the document.
        attributes: accessors of the geometric attributes, by attribute.
        targets: accessor of each morph target's deltas by name; None for targets that do not move the submesh.
        start, count: range of its vertices among those of all submeshes.
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
        """Positions `(vertex, 3)`, in local coordinates."""
        return read_numbers(file, self.attributes["POSITION"], "VEC3", f"POSITION of {self.label}")

    def deltas(self, file: GltfFile) -> Iterator[tuple[str, np.ndarray]]:
        """Name and deltas `(vertex, 3)` of each target that moves the submesh, in local coordinates."""
        for name, accessor in self.targets.items():
            if accessor is not None:
                yield name, read_numbers(file, accessor, "VEC3", f"target '{name}' of {self.label}")

    def binding(self, file: GltfFile, scene: Scene) -> Binding:
        return binding(file, scene, self.node, self.attributes, self.count, self.label)

    def rest_binding(self, file: GltfFile, scene: Scene) -> PosedBinding:
        return self.binding(file, scene).posed(scene.world)

    def triangles(self, file: GltfFile) -> np.ndarray:
        """Triangles `(face, 3)`, indices of the submesh's vertices."""
        return np.concatenate([read_triangles(file, primitive, self.count, self.label) for primitive in self.primitives])


def read_submeshes(file: GltfFile, nodes: list[int]) -> list[Submesh]:
    """Submeshes of the meshes of nodes, in the order of the file.

    Raises:
        InputError: vertices and targets do not match, or there are implausibly many.
    """
    names = target_names(file, sorted({file.document["nodes"][node]["mesh"] for node in nodes}))
    submeshes: dict[tuple, Submesh] = {}
    start = corners = 0
    for seen, (node, mesh, number, primitive) in enumerate(_primitives(file, nodes)):
        label = f"{mesh_label(file, mesh)}, primitive {number}"
        attributes = {name: accessor for name, accessor in primitive["attributes"].items() if name.startswith(GEOMETRIC)}
        moved = primitive.get("targets") or [{}] * len(names[mesh])
        targets = {name: target.get("POSITION") for name, target in zip(names[mesh], moved)}
        if "POSITION" not in attributes:
            raise InputError(f"{file.path}: {label} has no POSITION: the file is damaged; export it again")
        _refuse_compressed(file, primitive, attributes["POSITION"])
        count = count_of(file, attributes["POSITION"], f"POSITION of {label}")
        corners += count_of(file, primitive["indices"], f"indices of {label}") if "indices" in primitive else count
        key = (node, tuple(sorted(attributes.items())), tuple(targets.values()))
        if key in submeshes:  # primitives that differ in their material alone
            submeshes[key].primitives.append(primitive)
        else:
            _check_counts(file, targets, count, label)
            submeshes[key] = Submesh(label, node, mesh, attributes, targets, start, count, [primitive])
            start += count
        if max(3 * start * (1 + len(targets)), corners) > MOST_NUMBERS or seen >= MOST_PRIMITIVES:
            raise InputError(
                f"{file.path}: {start} vertices with {len(targets)} morph targets and {corners} corners in {seen + 1} "
                f"primitives are more than can be meant: choose meshes with rig.include=[NAME]"
            )
    if not submeshes:
        raise InputError(f"{file.path}: its meshes have no primitives, so there is no vertex: export it again")
    return list(submeshes.values())


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
    """Raises InputError where compressed vertices have no uncompressed fallback."""
    for name in COMPRESSED:
        if name in primitive.get("extensions", {}) and "bufferView" not in file.item("accessors", position, "POSITION"):
            raise compression_error(file.path, name)


def weld_map(file: GltfFile, scene: Scene, submeshes: list[Submesh]) -> np.ndarray:
    """Weld vertices that exporters split at seams: those of one node with equal positions, deltas and skin weights.

    Returns:
        `(file vertex,)` int64: index of the welded vertex of each; welded vertices keep their order.
    """
    seen: dict[bytes, int] = {}
    numbers = []
    for submesh in submeshes:
        columns = [submesh.positions(file), *(change for _, change in submesh.deltas(file))]
        if "skin" in file.document["nodes"][submesh.node]:
            columns.append(submesh.rest_binding(file, scene).weights)
        moved_by = [name for name, accessor in submesh.targets.items() if accessor is not None]
        start = f"{submesh.node} {moved_by} ".encode()
        rows = np.concatenate(columns, axis=1).astype(np.float32) + 0.0  # -0 becomes 0
        for row in rows:
            key = hashlib.blake2b(start + row.tobytes(), digest_size=20).digest()
            numbers.append(seen.setdefault(key, len(seen)))
    return np.array(numbers, dtype=np.int64)
