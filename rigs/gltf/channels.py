"""Reading and checking the channels of an animation."""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from riginv.errors import InputError, printable
from rigs.gltf.accessors import count_of, read_numbers
from rigs.gltf.animation import CUBIC, LINEAR, ROTATION, SCALE, STEP, TANGENTS, TRANSLATION, WEIGHTS, Channel
from rigs.gltf.container import GltfFile
from rigs.gltf.targets import target_count

KINDS = {TRANSLATION: "VEC3", ROTATION: "VEC4", SCALE: "VEC3", WEIGHTS: "SCALAR"}
MOST_KEYS = 10_000_000
POINTER = "KHR_animation_pointer"
TO_NODE = re.compile(r"/(nodes|meshes)/(\d{1,9})/(translation|rotation|scale|weights)")
MAY_MOVE = re.compile(r"/(nodes|meshes|skins|accessors)/")  # pointers to properties that affect vertices


def animation_names(file: GltfFile) -> list[str]:
    """Names of the animations; unnamed ones are numbered from 1."""
    found = file.document.get("animations", [])
    names = [animation.get("name") for animation in found]
    return [printable(name) if isinstance(name, str) and name else unnamed(number) for number, name in enumerate(names)]


def unnamed(number: int) -> str:
    """Display name of an unnamed animation, from its index."""
    return f"animation {number + 1}"


def read_channels(file: GltfFile, number: int) -> list[Channel]:
    """Channels of an animation.

    Args:
        number: index of the animation.

    Raises:
        InputError: a channel is damaged.
    """
    animation, found = file.document["animations"][number], []
    for index, channel in enumerate(animation["channels"]):
        user = f"animations[{number}].channels[{index}]"
        if channel["sampler"] >= len(animation["samplers"]):
            raise InputError(f"{file.path}: {user} names sampler {channel['sampler']} of {len(animation['samplers'])}")
        for node, path in _animated(file, channel["target"], user):
            if path == WEIGHTS and not _targets_of(file, node):
                file.note(f"{user} moves morph weights of node {node}, which has no morph targets: it is passed over.")
                continue
            found.append(_channel(file, animation["samplers"][channel["sampler"]], node, path, user))
    return found


def _animated(file: GltfFile, target: dict[str, Any], user: str) -> Iterator[tuple[int, str]]:
    """The nodes and paths that a channel animates: one, all nodes of a mesh, or none that is supported."""
    if "node" in target and target["path"] in KINDS:
        file.item("nodes", target["node"], user)
        yield target["node"], target["path"]
        return
    extension = target.get("extensions", {}).get(POINTER)
    pointer = extension.get("pointer") if isinstance(extension, dict) else None
    match = TO_NODE.fullmatch(pointer) if isinstance(pointer, str) else None
    if match and match[1] == "nodes":
        file.item("nodes", int(match[2]), user)
        yield int(match[2]), match[3]
    elif match and match[3] == WEIGHTS:
        for node, content in enumerate(file.document["nodes"]):
            if content.get("mesh") == int(match[2]) and "weights" not in content:
                yield node, WEIGHTS
    elif isinstance(pointer, str) and MAY_MOVE.match(pointer):
        file.note(f"{user} moves '{pointer[:80]}' by {POINTER}, which is not read: the meshes may move otherwise than here.")


def _targets_of(file: GltfFile, node: int) -> int:
    mesh = file.document["nodes"][node].get("mesh")
    if mesh is None:
        return 0
    file.item("meshes", mesh, f"nodes[{node}]")
    return target_count(file, mesh)


def _channel(file: GltfFile, sampler: dict[str, Any], node: int, path: str, user: str) -> Channel:
    interpolation = sampler.get("interpolation", LINEAR)
    if interpolation not in (STEP, LINEAR, CUBIC):
        raise InputError(f"{file.path}: {user}: interpolation {interpolation[:20]!r}, expected {STEP}, {LINEAR} or {CUBIC}")
    keys = count_of(file, sampler["input"], user)
    if keys > MOST_KEYS:
        raise InputError(f"{file.path}: {user} has {keys} keys: more than can be meant; export it again")
    times = read_numbers(file, sampler["input"], "SCALAR", f"input of {user}")[:, 0]
    values = read_numbers(file, sampler["output"], KINDS[path], f"output of {user}")
    width = _targets_of(file, node) if path == WEIGHTS else values.shape[1]
    each = TANGENTS if interpolation == CUBIC else 1
    if values.size != keys * each * width:
        raise InputError(
            f"{file.path}: output of {user} holds {values.size} numbers, expected {keys * each * width} for {keys} keys: "
            f"export it again"
        )
    _check_times(file, times, user)
    shape = (keys, TANGENTS, width) if each > 1 else (keys, width)
    return Channel(node, path, interpolation, times, values.reshape(shape))


def _check_times(file: GltfFile, times: np.ndarray, user: str) -> None:
    """Raises InputError unless times ascend; two keys at one time are a jump, three mean that times were lost."""
    steps = np.diff(times)
    if (steps < 0).any():
        raise InputError(f"{file.path}: {user}: its times do not rise: the file is damaged; export it again")
    if ((steps[1:] == 0) & (steps[:-1] == 0)).any():
        key = int(np.argmax((steps[1:] == 0) & (steps[:-1] == 0)))
        raise InputError(
            f"{file.path}: {user}: keys {key} to {key + 2} all stand at {times[key]:g} s, expected times that rise: "
            f"export it again, with an animation that starts near 0 s if this one starts late"
        )
