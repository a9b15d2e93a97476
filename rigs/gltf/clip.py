"""Animated glTF avatars as clips, with morph targets and skins evaluated."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, Polygons, SourceFacts
from riginv.errors import InputError
from riginv.meshes.mesh_file import MeshFile
from riginv.rig.interface import RigBackend
from rigs.gltf.bones import bones_clip
from rigs.gltf.channels import animation_names
from rigs.gltf.choice import Chosen, choice_notes, choose_animation, no_motion
from rigs.gltf.clip_meshes import ClipMeshes, clip_meshes, welded_faces
from rigs.gltf.container import UNIT_MM, GltfFile, open_gltf
from rigs.gltf.posing import PosedMeshes, poses_at
from rigs.gltf.rig import GltfRig
from rigs.gltf.scene import Scene, read_scene
from rigs.gltf.selection import listed_meshes, mesh_name, mesh_nodes
from rigs.gltf.still import GltfMesh
from rigs.gltf.timing import Timing, timing_of


class GltfClip(MeshSequence):
    """An animation of a .glb, .gltf or .vrm, sampled frame by frame.

    Args:
        path: of the file.
        options: `mesh`: names or globs of meshes or their nodes; None: the rig's. `animation`: a name, a number from 1 or
            several of these; None: the first that moves the meshes. `fps`: sampling rate; None: estimated from key times.
        rig: rig whose meshes are looked for in the file; None: the meshes that a rig of this file would have.

    Raises:
        InputError: the file cannot be read, or holds no animation of the meshes.
    """

    def __init__(self, path: str, options: ReadingOptions, rig: RigBackend | None = None) -> None:
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file; clip=PATH names a clip")
        file = open_gltf(path)
        scene = read_scene(file)
        selection, self.meshes, chosen = _select(file, scene, options, rig)
        timing = timing_of(path, [channel.times for channel in chosen.channels], _positive(options.fps))
        self.times = timing.seconds()
        self.channels = [
            channel._replace(times=timing.on_frames(channel.times))
            for channel in chosen.channels
            if self.meshes.follows(channel)
        ]
        faces, self.kept, count = self.meshes.faces(), None, self.meshes.vertex_count
        if selection.welded is not None:
            faces = welded_faces(faces, selection.welded)
            self.kept = np.unique(selection.welded, return_index=True)[1]
            count = len(self.kept)
        unit = rig.unit_mm if isinstance(rig, GltfRig) and _same_file(path, rig.file) else UNIT_MM
        numbers = timing.first + np.arange(timing.count)
        facts = _facts(file, scene, selection, self.meshes, chosen, timing)
        super().__init__(path, numbers, count, Polygons.triangles(faces), timing.rate.fps, unit, "y", facts)

    @classmethod
    def for_rig(cls, path: str, options: ReadingOptions, rig: RigBackend) -> MeshSequence:
        return bones_clip(path, options, rig) or cls(path, options, rig)

    @classmethod
    def still(cls, path: Path, options: ReadingOptions) -> MeshFile:
        return GltfMesh(path)

    def read(self, start: int, stop: int) -> np.ndarray:
        poses = poses_at(self.channels, self.times[start:stop])
        values = np.empty((len(poses), self.vertex_count, 3), np.float32)
        with np.errstate(over="ignore", invalid="ignore"):
            for frame, pose in enumerate(poses):
                vertices = self.meshes.vertices(pose)
                values[frame] = vertices if self.kept is None else vertices[self.kept]
        return values


def _select(
    file: GltfFile, scene: Scene, options: ReadingOptions, rig: RigBackend | None
) -> tuple[ClipMeshes, PosedMeshes, Chosen]:
    """Choose meshes and animation: of equally suitable meshes the first that an animation moves.

    Raises:
        InputError: no animation affects the meshes, or the file is damaged.
    """
    best = None
    for selection in clip_meshes(file, scene, options, rig):
        meshes = PosedMeshes(file, scene, selection.nodes)
        chosen = choose_animation(file, meshes, options.animation)
        if chosen and (best is None or chosen.moves):
            best = (selection, meshes, chosen)
        if chosen and chosen.moves:
            break
    if best is None:
        raise no_motion(file, listed_meshes(mesh_name(file, scene, node) for node in selection.nodes))
    return best


def _facts(
    file: GltfFile, scene: Scene, selection: ClipMeshes, meshes: PosedMeshes, chosen: Chosen, timing: Timing
) -> SourceFacts:
    names = {node: mesh_name(file, scene, node) for node in mesh_nodes(file, scene)}
    others = [name for node, name in names.items() if node not in selection.nodes]
    notes = []
    if others and selection.reason:
        read = listed_meshes(names[node] for node in selection.nodes)
        notes.append(
            f"Of its meshes {read} were read, {selection.reason}; not read: {listed_meshes(others)} "
            "(reading.mesh=[NAME] chooses)."
        )
    if selection.welded is not None:
        notes.append("Vertices at seams were welded as in the rig (rig.weld=true).")
    notes += choice_notes(file, meshes, chosen)
    notes += [timing.rate.note] if timing.rate.note else []
    animations = list(enumerate(animation_names(file)))
    return SourceFacts(
        "glTF",
        meshes=tuple(names[node].shown for node in selection.nodes),
        other_meshes=tuple(name.shown for name in others),
        animation=", ".join(name for number, name in animations if number in chosen.numbers),
        other_animations=tuple(name for number, name in animations if number not in chosen.numbers),
        rate_source=timing.rate.source,
        notes=(*notes, *file.notes),
    )


def _positive(fps: Any) -> float | None:
    """A usable frame rate, else None; unusable ones are refused where clips are opened."""
    return float(fps) if isinstance(fps, int | float) and 0 < fps < 1e6 else None


def _same_file(path: str, other: Path) -> bool:
    try:
        return os.path.samefile(path, other)
    except OSError:
        return False
