"""Reading the channels of an animation, each checked."""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from riginv.errors import InputError
from rigs.gltf.accessors import count_of, read_numbers
from rigs.gltf.animation import CUBIC, LINEAR, ROTATION, SCALE, STEP, TANGENTS, TRANSLATION, WEIGHTS, Channel
from rigs.gltf.container import GltfFile, printable
from rigs.gltf.targets import target_count

KINDS = {TRANSLATION: "VEC3", ROTATION: "VEC4", SCALE: "VEC3", WEIGHTS: "SCALAR"}
MOST_KEYS = 10_000_000
POINTER = "KHR_animation_pointer"
TO_NODE = re.compile(r"/(nodes|meshes)/(\d{1,9})/(translation|rotation|scale|weights)")
MAY_MOVE = re.compile(r"/(nodes|meshes|skins|accessors)/")  # pointers to something that places vertices


def animation_names(file: GltfFile) -> list[str]:
    """The names of the file's animations; one without a name is called by its number, which counts from 1."""
    found = file.document.get("animations", [])
    names = [animation.get("name") for animation in found]
    return [printable(name) if isinstance(name, str) and name else unnamed(number) for number, name in enumerate(names)]


def unnamed(number: int) -> str:
    """What an animation without a name is called; `number` counts from 0."""
    return f"animation {number + 1}"


def read_channels(file: GltfFile, number: int) -> list[Channel]:
    """The channels of an animation of the file.

    Args:
        number: which animation, from 0.

    Raises:
        InputError: one of its channels is damaged.
    """
    animation, found = file.document["animations"][number], []
    for place, channel in enumerate(animation["channels"]):
        user = f"animations[{number}].channels[{place}]"
        if channel["sampler"] >= len(animation["samplers"]):
            raise InputError(f"{file.path}: {user} names sampler {channel['sampler']} of {len(animation['samplers'])}")
        for node, what in _moved_by(file, channel["target"], user):
            if what == WEIGHTS and not _targets_of(file, node):
                file.note(f"{user} moves morph weights of node {node}, which has no morph targets: it is passed over.")
                continue
            found.append(_channel(file, animation["samplers"][channel["sampler"]], node, what, user))
    return found


def _moved_by(file: GltfFile, target: dict[str, Any], user: str) -> Iterator[tuple[int, str]]:
    """The nodes that a channel moves, and what of them: one, or all with one mesh, or none that is known."""
    if "node" in target and target["path"] in KINDS:
        file.item("nodes", target["node"], user)
        yield target["node"], target["path"]
        return
    extension = target.get("extensions", {}).get(POINTER)
    pointer = extension.get("pointer") if isinstance(extension, dict) else None
    way = TO_NODE.fullmatch(pointer) if isinstance(pointer, str) else None
    if way and way[1] == "nodes":
        file.item("nodes", int(way[2]), user)
        yield int(way[2]), way[3]
    elif way and way[3] == WEIGHTS:
        for node, content in enumerate(file.document["nodes"]):
            if content.get("mesh") == int(way[2]) and "weights" not in content:
                yield node, WEIGHTS
    elif isinstance(pointer, str) and MAY_MOVE.match(pointer):
        file.note(f"{user} moves '{pointer[:80]}' by {POINTER}, which is not read: the meshes may move otherwise than here.")


def _targets_of(file: GltfFile, node: int) -> int:
    mesh = file.document["nodes"][node].get("mesh")
    if mesh is None:
        return 0
    file.item("meshes", mesh, f"nodes[{node}]")
    return target_count(file, mesh)


def _channel(file: GltfFile, sampler: dict[str, Any], node: int, what: str, user: str) -> Channel:
    how = sampler.get("interpolation", LINEAR)
    if how not in (STEP, LINEAR, CUBIC):
        raise InputError(f"{file.path}: {user}: interpolation {how[:20]!r}, expected {STEP}, {LINEAR} or {CUBIC}")
    keys = count_of(file, sampler["input"], user)
    if keys > MOST_KEYS:
        raise InputError(f"{file.path}: {user} has {keys} keys: more than can be meant; export it again")
    times = read_numbers(file, sampler["input"], "SCALAR", f"input of {user}")[:, 0]
    values = read_numbers(file, sampler["output"], KINDS[what], f"output of {user}")
    width = _targets_of(file, node) if what == WEIGHTS else values.shape[1]
    each = TANGENTS if how == CUBIC else 1
    if values.size != keys * each * width:
        raise InputError(
            f"{file.path}: output of {user} holds {values.size} numbers, expected {keys * each * width} for {keys} keys: "
            f"export it again"
        )
    _check_times(file, times, user)
    return Channel(node, what, how, times, values.reshape((keys, TANGENTS, width) if each > 1 else (keys, width)))


def _check_times(file: GltfFile, times: np.ndarray, user: str) -> None:
    """Two keys at one time are a jump there; more are times that were lost."""
    steps = np.diff(times)
    if (steps < 0).any():
        raise InputError(f"{file.path}: {user}: its times do not rise: the file is damaged; export it again")
    if ((steps[1:] == 0) & (steps[:-1] == 0)).any():
        place = int(np.argmax((steps[1:] == 0) & (steps[:-1] == 0)))
        raise InputError(
            f"{file.path}: {user}: keys {place} to {place + 2} all stand at {times[place]:g} s, expected times that rise: "
            f"export it again, with an animation that starts near 0 s if this one starts late"
        )
