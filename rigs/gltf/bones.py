"""The motion of the nodes of a glTF file as that of a skeleton, for rigs whose mesh the file does not hold."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from riginv.clips.bones import BoneMotion, BonesClip, JointNamesError, match_names, motion_of_worlds
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import SourceFacts
from riginv.rig.interface import RigBackend
from rigs.gltf.animation import ROTATION, Channel
from rigs.gltf.channels import animation_names, read_channels
from rigs.gltf.choice import numbers_of
from rigs.gltf.clip_meshes import clip_meshes
from rigs.gltf.container import UNIT_MM, GltfFile, open_gltf
from rigs.gltf.posing import LOCAL, posed_scene, poses_at
from rigs.gltf.scene import Scene, read_scene
from rigs.gltf.selection import mesh_nodes
from rigs.gltf.timing import Timing, timing_of


def bones_clip(path: str, options: ReadingOptions, rig: RigBackend) -> BonesClip | None:
    """The skeleton in a file as a clip of a rig; None where the file holds the rig's mesh, or not its joints.

    Raises:
        InputError: the file is damaged.
    """
    of_meshes = options.mesh_names or options.vertices is not None
    skeleton = rig.skeleton() if Path(path).is_file() and not of_meshes else None
    if skeleton is None:
        return None
    file = open_gltf(path)
    scene = read_scene(file)
    if mesh_nodes(file, scene) and clip_meshes(file, scene, options, rig)[0].fits:
        return None
    try:
        matched = {number for number in match_names(skeleton.joint_names, scene.names, path, rig.name) if number >= 0}
    except JointNamesError:
        return None  # as a clip of meshes it is refused with what it lacks
    numbers, channels = _animation(file, options, matched)
    if not channels:
        return None
    fps = options.fps if isinstance(options.fps, int | float) and 0 < options.fps < 1e6 else None
    timing = timing_of(path, [channel.times for channel in channels], fps)
    names = animation_names(file)
    facts = SourceFacts(
        "glTF, joints",
        animation=", ".join(names[number] for number in numbers),
        other_animations=tuple(name for number, name in enumerate(names) if number not in numbers),
        rate_source=timing.rate.source,
        notes=("Its meshes are not the rig's: its joints move the rig.", *file.notes),
    )
    return BonesClip(path, _motion(file, scene, channels, timing, sorted(matched)), rig, facts)


def _animation(file: GltfFile, options: ReadingOptions, joints: set[int]) -> tuple[Sequence[int], list[Channel]]:
    """The animations that were asked for, or the first that rotates one of the joints."""
    requested = options.animation is not None
    for numbers in [numbers_of(file, options.animation)] if requested else [(n,) for n in range(len(animation_names(file)))]:
        channels = [channel for number in numbers for channel in read_channels(file, number) if channel.path in LOCAL]
        if requested or any(channel.node in joints and channel.path == ROTATION for channel in channels):
            return numbers, channels
    return (), []


def _motion(file: GltfFile, scene: Scene, channels: list[Channel], timing: Timing, joints: list[int]) -> BoneMotion:
    """The motion of nodes `joints`, of which each but the topmost has the nearest one above it as parent."""
    moving = [channel._replace(times=timing.on_frames(channel.times)) for channel in channels]
    rest = scene.world[joints]
    worlds = torch.stack([posed_scene(file, scene, pose).world[joints] for pose in poses_at(moving, timing.seconds())])
    number_of, parents = {node: number for number, node in enumerate(joints)}, []
    for node in joints:
        parent = scene.parents[node]
        while parent >= 0 and parent not in number_of:
            parent = scene.parents[parent]
        parents.append(number_of.get(parent, -1))
    motion = motion_of_worlds([scene.names[node] for node in joints], parents, rest, worlds, timing.rate.fps)
    return motion._replace(frame_numbers=timing.first + np.arange(timing.count), unit_mm=UNIT_MM)
