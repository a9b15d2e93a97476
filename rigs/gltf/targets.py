"""Morph targets: their names, and their values at rest."""

import re
from collections import Counter
from collections.abc import Iterator

from riginv.errors import InputError
from rigs.gltf.container import GltfFile

MOST_TARGETS = 10_000
BASIS = "Basis"  # what Blender calls the shape that its shape keys start from; glTF does not list it
NUMBERED = re.compile(r"accessors?[\s_.-]*\d*", re.IGNORECASE)  # names that exporters give to accessors of any kind
SHOWN = 4  # names that a note lists


def mesh_label(file: GltfFile, mesh: int) -> str:
    """What messages call a mesh."""
    name = file.document["meshes"][mesh].get("name")
    return f"mesh '{name}'" if name else f"meshes[{mesh}]"


def target_count(file: GltfFile, mesh: int) -> int:
    """How many morph targets a mesh has; primitives without any are not moved by those of the others.

    Raises:
        InputError: its primitives have different numbers of them, or there are absurdly many.
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
    """The names of the morph targets of meshes, by the mesh's number; no two targets of one mesh have the same name.

    They stand in `extras.targetNames` of the mesh, as exporters agreed on, or of a primitive; older exporters wrote them into
    the targets themselves or gave them to the accessors of their positions. Targets without names are called `target_0`,
    `target_1`..., and with the mesh's name before that where several meshes have none: that they are the same targets is
    nowhere said.

    Raises:
        InputError: names are no texts.
    """
    names, nameless = {}, []
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


def _numbered(number: int) -> str:
    return f"target_{number}"


def _one_for_each(file: GltfFile, mesh: int, found: list[str], count: int) -> list[str]:
    """A name for each target: names that are missing are numbers, and those beyond the last target are left out."""
    if len(found) == count + 1 and found[0] == BASIS:
        found = found[1:]
        file.note(f"extras.targetNames of {mesh_label(file, mesh)} begins with '{BASIS}', which is no target: it was left out.")
    if len(found) != count and count:
        what = f"'{_numbered(len(found))}' and so on name the others" if len(found) < count else f"'{found[count]}' is left out"
        file.note(
            f"{mesh_label(file, mesh)} has {count} morph targets and names {len(found)} in extras.targetNames: the names were "
            f"given in their order, and {what}; names may stand at the wrong targets."
        )
    return [(found[number] if number < len(found) else "") or _numbered(number) for number in range(count)]


def _unique(file: GltfFile, mesh: int, names: list[str]) -> list[str]:
    """The names, where one stands there again with a number that makes it another."""
    taken, seen, renamed, result = set(names), Counter(), [], []
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
        several = ", ".join(renamed[:SHOWN]) + (f" and {len(renamed) - SHOWN} more" if len(renamed) > SHOWN else "")
        file.note(
            f"{len(renamed)} morph targets of {mesh_label(file, mesh)} have names that others of it have, too: they are called "
            f"{several}."
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
    targets = next((primitive["targets"] for primitive in found["primitives"] if primitive.get("targets")), [])
    for source in (_names_within, _names_of_accessors):
        names = list(source(file, targets))
        moving = [name for name, target in zip(names, targets) if "POSITION" in target]
        if moving and all(moving) and len(set(moving)) == len(moving):
            return names
    return None


def _names_within(file: GltfFile, targets: list[dict]) -> Iterator[str]:
    """The names that UniVRM and others wrote into the targets."""
    for target in targets:
        extras = target.get("extras", target.get("extra"))
        name = extras.get("name") if isinstance(extras, dict) else None
        yield name if isinstance(name, str) else ""


def _names_of_accessors(file: GltfFile, targets: list[dict]) -> Iterator[str]:
    """The names of the accessors of the targets' positions, without those that only number them."""
    accessors = file.document.get("accessors", [])
    for target in targets:
        place = target.get("POSITION", len(accessors))
        name = accessors[place].get("name") if place < len(accessors) else None
        yield name if isinstance(name, str) and not NUMBERED.fullmatch(name) else ""
