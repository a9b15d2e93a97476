"""Morph targets: names and default weights."""

import re
from collections import Counter
from collections.abc import Iterator

from riginv.errors import InputError, listed
from rigs.gltf.container import GltfFile

MOST_TARGETS = 10_000
BASIS = "Basis"  # Blender's reference shape, which is no target
NUMBERED = re.compile(r"accessors?[\s_.-]*\d*", re.IGNORECASE)  # names that exporters give to accessors of any kind


def mesh_label(file: GltfFile, mesh: int) -> str:
    """A mesh's name for messages."""
    name = file.document["meshes"][mesh].get("name")
    return f"mesh '{name}'" if name else f"meshes[{mesh}]"


def target_count(file: GltfFile, mesh: int) -> int:
    """Number of morph targets of a mesh; primitives without any are not moved by those of others.

    Raises:
        InputError: its primitives have different numbers of targets, or there are too many.
    """
    counts = [len(primitive.get("targets", [])) for primitive in file.document["meshes"][mesh]["primitives"]]
    most = max(counts, default=0)
    if most > MOST_TARGETS or len(set(counts) - {0}) > 1:
        raise InputError(
            f"{file.path}: the primitives of {mesh_label(file, mesh)} have {', '.join(map(str, counts[:6]))} morph targets, "
            f"expected the same number for all, at most {MOST_TARGETS}: export it again"
        )
    if len(set(counts)) > 1:
        file.note(
            f"{counts.count(0)} of the {len(counts)} primitives of {mesh_label(file, mesh)} have no morph targets: its {most} "
            f"targets do not move them."
        )
    return most


def target_names(file: GltfFile, meshes: list[int]) -> dict[int, list[str]]:
    """Unique names of the morph targets of each mesh, by the mesh's index.

    Exporters store them in `extras.targetNames` of the mesh or of a primitive; older ones in the targets themselves, or as
    names of the position accessors. Unnamed targets become `target_0`, `target_1`..., prefixed with the mesh's name where
    several meshes have none, since these need not be the same targets.

    Raises:
        InputError: names are not strings.
    """
    names: dict[int, list[str]] = {}
    nameless: list[int] = []
    for mesh in meshes:
        count, found = target_count(file, mesh), _names_in_file(file, mesh)
        if found is None:
            nameless += [mesh] if count else []
            names[mesh] = [_numbered(number) for number in range(count)]
        else:
            names[mesh] = _unique(file, mesh, _one_for_each(file, mesh, found, count))
    if len(nameless) > 1:
        for mesh in nameless:
            prefix = file.document["meshes"][mesh].get("name") or f"mesh_{mesh}"
            names[mesh] = [f"{prefix}.{name}" for name in names[mesh]]
    return names


def default_weights(file: GltfFile, mesh: int, node: dict, names: list[str]) -> dict[str, float]:
    """Default weights of morph targets by name: those of the node, else of the mesh.

    Raises:
        InputError: the numbers of weights and targets differ.
    """
    weights = node.get("weights") or file.document["meshes"][mesh].get("weights") or [0.0] * len(names)
    if len(weights) != len(names):
        raise InputError(
            f"{file.path}: {mesh_label(file, mesh)} has {len(weights)} weights for its {len(names)} morph targets: "
            f"export it again"
        )
    return dict(zip(names, weights))


def _numbered(number: int) -> str:
    return f"target_{number}"


def _one_for_each(file: GltfFile, mesh: int, found: list[str], count: int) -> list[str]:
    """One name for each target: missing names are numbered, surplus ones dropped."""
    if len(found) == count + 1 and found[0] == BASIS:
        found = found[1:]
        file.note(f"extras.targetNames of {mesh_label(file, mesh)} begins with '{BASIS}', which is no target: it was left out.")
    if len(found) != count and count:
        what = f"'{_numbered(len(found))}' and so on name the others" if len(found) < count else f"'{found[count]}' is left out"
        file.note(
            f"{mesh_label(file, mesh)} has {count} morph targets and names {len(found)} in extras.targetNames: the names were "
            f"given in their order, and {what}; names may be at the wrong targets."
        )
    return [(found[number] if number < len(found) else "") or _numbered(number) for number in range(count)]


def _unique(file: GltfFile, mesh: int, names: list[str]) -> list[str]:
    """Names made unique: repeated ones get a number."""
    taken, seen = set(names), Counter[str]()
    renamed: list[str] = []
    result: list[str] = []
    for name in names:
        seen[name] += 1
        new = name
        while new in taken and seen[name] > 1:
            new = f"{name}_{seen[name]}"
            seen[name] += new in taken
        renamed += [f"'{new}'"] if new != name else []
        taken.add(new)
        result.append(new)
    if renamed:
        file.note(
            f"{len(renamed)} morph targets of {mesh_label(file, mesh)} have names that others of it have, too: they are called "
            f"{listed(renamed)}."
        )
    return result


def _names_in_file(file: GltfFile, mesh: int) -> list[str] | None:
    found = file.document["meshes"][mesh]
    for holder in (found, *found["primitives"]):
        extras = holder.get("extras")
        names = extras.get("targetNames") if isinstance(extras, dict) else None
        if names is not None:
            if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
                raise InputError(
                    f"{file.path}: extras.targetNames of {mesh_label(file, mesh)} is no list of texts: export it again"
                )
            return names
    targets: list[dict] = next((primitive["targets"] for primitive in found["primitives"] if primitive.get("targets")), [])
    for source in (_names_within, _names_of_accessors):
        names = list(source(file, targets))
        moving = [name for name, target in zip(names, targets) if "POSITION" in target]
        if moving and all(moving) and len(set(moving)) == len(moving):
            return names
    return None


def _names_within(file: GltfFile, targets: list[dict]) -> Iterator[str]:
    """Names stored in the targets, as by UniVRM."""
    for target in targets:
        extras = target.get("extras", target.get("extra"))
        name = extras.get("name") if isinstance(extras, dict) else None
        yield name if isinstance(name, str) else ""


def _names_of_accessors(file: GltfFile, targets: list[dict]) -> Iterator[str]:
    """Names of the position accessors of the targets, except generic ones."""
    accessors = file.document.get("accessors", [])
    for target in targets:
        index = target.get("POSITION", len(accessors))
        name = accessors[index].get("name") if index < len(accessors) else None
        yield name if isinstance(name, str) and not NUMBERED.fullmatch(name) else ""
