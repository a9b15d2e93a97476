"""Which of a file's animations is read: those that the user names, else the first that moves the chosen meshes."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from riginv.errors import InputError
from rigs.gltf.animation import CUBIC, Channel
from rigs.gltf.channels import animation_names, read_channels, unnamed
from rigs.gltf.container import GltfFile
from rigs.gltf.posing import PosedMeshes, moves_at

MOVES = 1e-5  # of the size of meshes, that a vertex must move for them to count as moved
LOOKS = 48  # poses, at most, that are looked at beside those farthest from the first
KNOWN = 10  # animations that a message lists


class Chosen(NamedTuple):
    """What is read.

    Attributes:
        numbers: of the animations, from 0.
        channels: all of theirs; what two of them move is moved by the later.
        moves: whether they move the meshes.
        asked: whether the user named them.
    """

    numbers: tuple[int, ...]
    channels: list[Channel]
    moves: bool
    asked: bool = False


def choose_animation(file: GltfFile, meshes: PosedMeshes, asked: Any) -> Chosen | None:
    """The animation to read.

    Args:
        asked: its name, or its number from 1, or a list of these; None: the first that moves the meshes, or else holds them
            in a pose.

    Returns:
        None where none was asked for and none has anything to do with the meshes.

    Raises:
        InputError: there are no animations, or not that one, or one that was looked at is damaged.
    """
    names = animation_names(file)
    if not names:
        raise InputError(f"{file.path}: no animation in it: export it with its animation, or give another clip")
    if asked is not None:
        return _asked(file, meshes, names, asked if isinstance(asked, list | tuple) else [asked])
    still = None
    for number in range(len(names)):
        channels = read_channels(file, number)
        if is_moved(meshes, channels):
            return Chosen((number,), channels, True)
        if still is None and any(meshes.follows(channel) for channel in channels):
            still = Chosen((number,), channels, False)
    return still


def is_moved(meshes: PosedMeshes, channels: Iterable[Channel]) -> bool:
    """Whether channels make any vertex go anywhere: not by a constant, nor by what other channels undo."""
    acting = [channel for channel in channels if meshes.follows(channel)]
    varying = [channel for channel in acting if channel.varies()]
    if not varying:
        return False
    keys = np.unique(np.concatenate([channel.times for channel in varying]))
    between = [keys[:-1] + part * np.diff(keys) for part in (1 / 3, 2 / 3)]  # halfway even tangents cancel
    spread = np.concatenate([keys, *between]) if any(channel.how == CUBIC for channel in varying) else keys
    spread = spread[np.unique(np.linspace(0, len(spread) - 1, LOOKS).round().astype(int))]
    farthest = dict.fromkeys(float(channel.times[channel.farthest_key()]) for channel in varying)
    with np.errstate(over="ignore", invalid="ignore"):
        start = meshes.vertices(moves_at(acting, keys[:1])[0])
        least = MOVES * float(np.ptp(start, axis=0).max())
        for time in (*farthest, *spread):
            if not np.abs(meshes.vertices(moves_at(acting, np.array([time]))[0]) - start).max() <= least:
                return True
    return False


def choice_notes(file: GltfFile, meshes: PosedMeshes, chosen: Chosen) -> list[str]:
    """What the user should know of a choice: what was passed over, and that nothing moves."""
    names, read = animation_names(file), chosen.numbers[0]
    said = f"Animation {read + 1}" + f", '{names[read]}'," * (names[read] != unnamed(read))
    notes = [] if chosen.moves else [f"{said} does not move the meshes that were read: all frames are one pose."]
    if chosen.asked or len(names) == 1:
        return notes
    others = [number for number in range(len(names)) if number != read]
    why = "the first that moves the meshes that were read" if chosen.moves else "the first that holds them in a pose"
    notes.append(f"{said} was read, {why}; not read: {_several(names, others)} (reading.animation=NAME or NUMBER chooses).")
    if found := _parts_elsewhere(file, meshes, chosen, others[:KNOWN]):
        numbers = ",".join(str(number + 1) for number in (read, *found))
        notes.append(
            f"What that animation leaves still of these meshes is moved by {_several(names, found)}: "
            f"reading.animation=[{numbers}] plays them together."
        )
    return notes


def no_motion(file: GltfFile, meshes: str) -> InputError:
    """What to say where no animation has anything to do with the meshes."""
    names = animation_names(file)
    return InputError(
        f"{file.path}: none of its animations ({_all(names)}) moves {meshes}: name other meshes with reading.mesh=[NAME], or "
        f"read one of them as a still with reading.animation=NUMBER"
    )


def _asked(file: GltfFile, meshes: PosedMeshes, names: list[str], asked: Sequence[Any]) -> Chosen:
    numbers = tuple(dict.fromkeys(_number_of(file, names, one) for one in asked))
    found: dict[tuple[int, str], Channel] = {}
    for number in numbers:
        found |= {(channel.node, channel.what): channel for channel in read_channels(file, number)}
    channels = list(found.values())
    if not channels:
        raise InputError(
            f"{file.path}: reading.animation={_said(asked)} moves nothing; the file's animations are: {_all(names)}"
        )
    return Chosen(numbers, channels, is_moved(meshes, channels), asked=True)


def _parts_elsewhere(file: GltfFile, meshes: PosedMeshes, chosen: Chosen, others: Iterable[int]) -> list[int]:
    """Other animations that move what the chosen one does not, and nothing else, as where exporters make one of each action."""
    if not chosen.moves:
        return []
    taken, found = {(one.node, one.what) for one in chosen.channels if meshes.follows(one)}, []
    for number in others:
        try:
            channels = [channel for channel in read_channels(file, number) if meshes.follows(channel)]
        except InputError:  # it is not read
            continue
        moved = {(channel.node, channel.what) for channel in channels}
        if not moved & taken and is_moved(meshes, channels):
            found.append(number)
            taken |= moved
    return found


def _all(names: list[str]) -> str:
    return _several(names, range(len(names)))


def _several(names: list[str], numbers: Iterable[int]) -> str:
    each = [f"{number + 1}" + f" '{names[number]}'" * (names[number] != unnamed(number)) for number in numbers]
    return ", ".join(each[:KNOWN]) + (f" and {len(each) - KNOWN} more" if len(each) > KNOWN else "")


def _said(asked: Sequence[Any]) -> str:
    return ",".join(str(one) for one in asked)[:80]


def _number_of(file: GltfFile, names: list[str], asked: Any) -> int:
    """The number from 0 of an animation that is named, or numbered from 1."""
    said = str(asked)
    alike = [number for number, name in enumerate(names) if name == said]
    alike = alike or [number for number, name in enumerate(names) if name.casefold() == said.casefold()]
    whole = isinstance(asked, int) and not isinstance(asked, bool)
    if (whole or not alike) and said.isascii() and said.isdigit() and 1 <= int(said[:9]) <= len(names):
        return int(said[:9]) - 1
    if len(alike) == 1:
        return alike[0]
    if alike:
        raise InputError(
            f"{file.path}: {len(alike)} animations are named {said[:80]!r}: give a number, reading.animation={alike[0] + 1} or "
            f"{alike[1] + 1}"
        )
    raise InputError(
        f"{file.path}: reading.animation is {said[:80]!r}, no animation is called or numbered so; they are: {_all(names)}"
    )
