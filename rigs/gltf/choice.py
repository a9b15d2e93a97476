"""Selection of the animation: as the user requests, else the first that moves the chosen meshes."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from riginv.clips.sequence import ScansError
from riginv.errors import InputError, listed
from rigs.gltf.animation import CUBIC, Channel
from rigs.gltf.channels import animation_names, read_channels, unnamed
from rigs.gltf.container import GltfFile
from rigs.gltf.posing import PosedMeshes, poses_at

MOVES = 1e-5  # fraction of the meshes' size that a vertex must move
LOOKS = 48  # most sampled poses, beside those farthest from the first
COMPARED = 10  # other animations, of which those that move other parts are looked for


class Chosen(NamedTuple):
    """Animations that are read.

    Attributes:
        numbers: indices of the animations.
        channels: of all of them; where two animate the same property the later one counts.
        moves: whether they move the meshes.
        requested: whether the user named them.
    """

    numbers: tuple[int, ...]
    channels: list[Channel]
    moves: bool
    requested: bool = False


def choose_animation(file: GltfFile, meshes: PosedMeshes, requested: Any) -> Chosen | None:
    """Choose the animation to read.

    Args:
        requested: name, number from 1, or a list of these; None: the first that moves the meshes, else one that poses them.

    Returns:
        None where none was requested and none affects the meshes.

    Raises:
        InputError: there is no such animation, or one that was read is damaged.
    """
    names = animation_names(file)
    if not names:
        raise ScansError(
            f"{file.path}: no animation in it: export it with its animation, or give another clip "
            f"(correspondence=surface fits a still mesh as a scan)"
        )
    if requested is not None:
        return _requested(file, meshes, names, requested if isinstance(requested, list | tuple) else [requested])
    still = None
    for number in range(len(names)):
        channels = read_channels(file, number)
        if is_moved(meshes, channels):
            return Chosen((number,), channels, True)
        if still is None and any(meshes.follows(channel) for channel in channels):
            still = Chosen((number,), channels, False)
    return still


def is_moved(meshes: PosedMeshes, channels: Iterable[Channel]) -> bool:
    """Whether channels displace any vertex over time."""
    acting = [channel for channel in channels if meshes.follows(channel)]
    varying = [channel for channel in acting if channel.varies()]
    if not varying:
        return False
    keys = np.unique(np.concatenate([channel.times for channel in varying]))
    between = [keys[:-1] + part * np.diff(keys) for part in (1 / 3, 2 / 3)]  # halfway even tangents cancel
    spread = np.concatenate([keys, *between]) if any(channel.interpolation == CUBIC for channel in varying) else keys
    spread = spread[np.unique(np.linspace(0, len(spread) - 1, LOOKS).round().astype(int))]
    farthest = dict.fromkeys(float(channel.times[channel.farthest_key()]) for channel in varying)
    with np.errstate(over="ignore", invalid="ignore"):
        start = meshes.vertices(poses_at(acting, keys[:1])[0])
        least = MOVES * float(np.ptp(start, axis=0).max())
        for time in (*farthest, *spread):
            if not np.abs(meshes.vertices(poses_at(acting, np.array([time]))[0]) - start).max() <= least:
                return True
    return False


def choice_notes(file: GltfFile, meshes: PosedMeshes, chosen: Chosen) -> list[str]:
    """Notes for the user: animations that were not read, and whether anything moves."""
    names, read = animation_names(file), chosen.numbers[0]
    text = f"Animation {read + 1}" + f", '{names[read]}'," * (names[read] != unnamed(read))
    notes = []
    if not chosen.moves:
        times = {float(time) for channel in chosen.channels for time in channel.times}
        still = "does not move the meshes that were read: all frames are one pose"
        notes.append(f"{text} {'has keys at one time: that pose was read' if len(times) == 1 else still}.")
    if chosen.requested or len(names) == 1:
        return notes
    others = [number for number in range(len(names)) if number != read]
    why = "the first that moves the meshes that were read" if chosen.moves else "the first that holds them in a pose"
    notes.append(f"{text} was read, {why}; not read: {_several(names, others)} (reading.animation=NAME or NUMBER chooses).")
    if found := _parts_elsewhere(file, meshes, chosen, others[:COMPARED]):
        numbers = ",".join(str(number + 1) for number in (read, *found))
        notes.append(
            f"What that animation leaves still of these meshes is moved by {_several(names, found)}: "
            f"reading.animation=[{numbers}] plays them together."
        )
    return notes


def no_motion(file: GltfFile, meshes: str) -> InputError:
    """The error where no animation affects the meshes."""
    names = animation_names(file)
    return InputError(
        f"{file.path}: none of its animations ({_all(names)}) moves {meshes}: name other meshes with reading.mesh=[NAME], or "
        f"read one of them as a still with reading.animation=NUMBER"
    )


def numbers_of(file: GltfFile, requested: Any) -> tuple[int, ...]:
    """Indices of animations given by a name, a number from 1, or a list of these.

    Raises:
        InputError: there is no such animation.
    """
    several = requested if isinstance(requested, list | tuple) else [requested]
    return tuple(dict.fromkeys(_number_of(file, animation_names(file), one) for one in several))


def _requested(file: GltfFile, meshes: PosedMeshes, names: list[str], requested: Sequence[Any]) -> Chosen:
    numbers = numbers_of(file, requested)
    found: dict[tuple[int, str], Channel] = {}
    for number in numbers:
        found |= {(channel.node, channel.path): channel for channel in read_channels(file, number)}
    channels = list(found.values())
    if not channels:
        text = ",".join(map(str, requested))[:80]
        raise InputError(f"{file.path}: reading.animation={text} moves nothing; the file's animations are: {_all(names)}")
    return Chosen(numbers, channels, is_moved(meshes, channels), requested=True)


def _parts_elsewhere(file: GltfFile, meshes: PosedMeshes, chosen: Chosen, others: Iterable[int]) -> list[int]:
    """Other animations that move only what the chosen one does not, as some exporters write one for each action."""
    if not chosen.moves:
        return []
    taken, found = {(one.node, one.path) for one in chosen.channels if meshes.follows(one)}, []
    for number in others:
        try:
            channels = [channel for channel in read_channels(file, number) if meshes.follows(channel)]
        except InputError:  # damaged, and not read
            continue
        moved = {(channel.node, channel.path) for channel in channels}
        if not moved & taken and is_moved(meshes, channels):
            found.append(number)
            taken |= moved
    return found


def _all(names: list[str]) -> str:
    return _several(names, range(len(names)))


def _several(names: list[str], numbers: Iterable[int]) -> str:
    each = [f"{number + 1}" + f" '{names[number]}'" * (names[number] != unnamed(number)) for number in numbers]
    return listed(each)


def _number_of(file: GltfFile, names: list[str], requested: Any) -> int:
    """Index of an animation given by its name, or by its number from 1."""
    text = str(requested)
    alike = [number for number, name in enumerate(names) if name == text]
    alike = alike or [number for number, name in enumerate(names) if name.casefold() == text.casefold()]
    whole = isinstance(requested, int) and not isinstance(requested, bool)
    if (whole or not alike) and text.isascii() and text.isdigit() and 1 <= int(text[:9]) <= len(names):
        return int(text[:9]) - 1
    if len(alike) == 1:
        return alike[0]
    if alike:
        raise InputError(
            f"{file.path}: {len(alike)} animations are named {text[:80]!r}: give a number, reading.animation={alike[0] + 1} or "
            f"{alike[1] + 1}"
        )
    raise InputError(
        f"{file.path}: reading.animation is {text[:80]!r}, no animation is called or numbered so; they are: {_all(names)}"
    )
