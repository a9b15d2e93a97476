"""Morph targets: their names, and their values at rest."""

from riginv.errors import InputError
from rigs.gltf.container import GltfFile

MOST_TARGETS = 10_000


def mesh_label(file: GltfFile, mesh: int) -> str:
    """What messages call a mesh."""
    name = file.document["meshes"][mesh].get("name")
    return f"mesh '{name}'" if name else f"meshes[{mesh}]"


def target_count(file: GltfFile, mesh: int) -> int:
    """How many morph targets a mesh has.

    Raises:
        InputError: its primitives have different numbers of them, or there are absurdly many.
    """
    counts = [len(primitive.get("targets", [])) for primitive in file.document["meshes"][mesh]["primitives"]]
    if len(set(counts)) > 1 or max(counts, default=0) > MOST_TARGETS:
        raise InputError(
            f"{file.path}: the primitives of {mesh_label(file, mesh)} have {', '.join(map(str, counts[:6]))} morph targets, "
            f"expected the same number for all, at most {MOST_TARGETS}: export it again"
        )
    return counts[0] if counts else 0


def target_names(file: GltfFile, meshes: list[int]) -> dict[int, list[str]]:
    """The names of the morph targets of meshes, by the mesh's number.

    They stand in `extras.targetNames` of the mesh, as exporters agreed on (of its first primitive with some); targets without
    names are called `target_0`, `target_1`..., and with the mesh's name before that where several meshes have none: that they
    are the same targets is nowhere said.

    Raises:
        InputError: a name stands twice in one mesh, or there are more or fewer names than targets.
    """
    names, nameless = {}, []
    for mesh in meshes:
        count, found = target_count(file, mesh), _names_in_file(file, mesh)
        if found is None:
            nameless += [mesh] if count else []
            names[mesh] = [f"target_{number}" for number in range(count)]
            continue
        label = mesh_label(file, mesh)
        if len(found) != count:
            raise InputError(
                f"{file.path}: {label} names {len(found)} morph targets in extras.targetNames, it has {count}: export it again"
            )
        for second, name in enumerate(found):
            first = found.index(name)
            if first != second:
                raise InputError(
                    f"{file.path}: morph targets {first} and {second} of {label} are both named '{name}': rename one of them"
                )
        names[mesh] = found
    if len(nameless) > 1:
        for mesh in nameless:
            prefix = file.document["meshes"][mesh].get("name") or f"mesh_{mesh}"
            names[mesh] = [f"{prefix}.{name}" for name in names[mesh]]
    return names


def default_weights(file: GltfFile, mesh: int, node: dict, names: list[str]) -> dict[str, float]:
    """The weights that a file gives morph targets at rest, by name: those of the node before those of the mesh.

    Raises:
        InputError: there are more or fewer weights than targets.
    """
    weights = node.get("weights") or file.document["meshes"][mesh].get("weights") or [0.0] * len(names)
    if len(weights) != len(names):
        raise InputError(
            f"{file.path}: {mesh_label(file, mesh)} has {len(weights)} weights for its {len(names)} morph targets: "
            f"export it again"
        )
    return dict(zip(names, weights))


def _names_in_file(file: GltfFile, mesh: int) -> list[str] | None:
    found = file.document["meshes"][mesh]
    for holder in (found, *found["primitives"][:1]):
        extras = holder.get("extras")
        names = extras.get("targetNames") if isinstance(extras, dict) else None
        if names is not None:
            if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
                raise InputError(
                    f"{file.path}: extras.targetNames of {mesh_label(file, mesh)} is no list of texts: export it again"
                )
            return names
    return None
