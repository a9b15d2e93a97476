"""Which reader a path needs: by the ending of its name."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from riginv.build import build
from riginv.clips.arrays import ArrayClip
from riginv.clips.file_frames import ObjFrames, PlyFrames
from riginv.clips.live_link import live_link_clip
from riginv.clips.numbered import is_pattern
from riginv.clips.point_caches import MddCache, Pc2Cache
from riginv.clips.sequence import MeshSequence, Polygons
from riginv.errors import InputError
from riginv.rig import RigBackend

FRAMES: Mapping[str, type[MeshSequence]] = {".obj": ObjFrames, ".ply": PlyFrames}
CACHES: Mapping[str, Callable[[Path], MeshSequence]] = {
    ".npz": ArrayClip,
    ".npy": ArrayClip,
    ".mdd": MddCache,
    ".pc2": Pc2Cache,
}
PLUG_INS = {
    **dict.fromkeys((".glb", ".gltf", ".vrm"), "rigs.gltf.clip.GltfClip"),
    **dict.fromkeys((".abc", ".fbx"), "rigs.blender.clip.BlenderClip"),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), "rigs.usd.clip.UsdClip"),
}
KNOWN = (*CACHES, *FRAMES, *PLUG_INS, ".csv")
TAKEN = {  # the options that a plug-in takes
    "rigs.gltf.clip.GltfClip": ("mesh", "fps"),
    "rigs.blender.clip.BlenderClip": ("mesh", "fps", "interpreter"),
    "rigs.usd.clip.UsdClip": ("mesh",),
}


class RecordedShapes(MeshSequence):
    """A Live Link Face recording: its curves onto the shapes of a rig."""

    def __init__(self, path: Path, rig: RigBackend) -> None:
        self.shapes = live_link_clip(path, rig)
        faces = Polygons.triangles(rig.faces.cpu().numpy())
        super().__init__(path, np.arange(len(self.shapes)), len(rig.rest_vertices), faces, self.shapes.fps, 1.0, "y")

    def read(self, start: int, stop: int) -> np.ndarray:
        return self.shapes.vertices(start, stop).float().cpu().numpy()


def open_sequence(path: str, rig: RigBackend, options: Mapping[str, Any]) -> MeshSequence:
    """Open a clip with the reader that its name calls for.

    Args:
        rig: whose mesh it should hold.
        options: `mesh`: which mesh of a file with several; `missing_frames`: `error` or `bridge`; `fps`, where given;
            `interpreter`: a Python with bpy, or Blender, for Alembic and FBX.

    Raises:
        InputError: no reader knows the name, or the file is missing or damaged.
    """
    given = Path(path)
    suffix = given.suffix.lower()
    bridge = options["missing_frames"] == "bridge"
    if _is_folder(given):
        inside = {file.suffix.lower() for file in given.iterdir()} & set(FRAMES)
        if len(inside) != 1:
            raise InputError(f"{path}: a folder, expected to hold OBJ or PLY files, one for each frame, and not both")
        return FRAMES[inside.pop()](path, bridge)
    if suffix in FRAMES:
        return FRAMES[suffix](path, bridge)
    if is_pattern(path) and not given.exists():
        raise InputError(f"{path}: patterns are for OBJ and PLY files, one for each frame: expected one ending in .obj or .ply")
    if suffix in CACHES:
        return CACHES[suffix](given)
    if suffix == ".csv":
        return RecordedShapes(given, rig)
    if suffix in PLUG_INS:
        plug_in = PLUG_INS[suffix]
        return build({"_target_": plug_in, "path": path, **{name: options[name] for name in TAKEN[plug_in]}}, kind=MeshSequence)
    raise InputError(f"{path}: clips end in {', '.join(KNOWN)}; convert it to one of these")


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except (OSError, ValueError) as error:
        raise InputError(f"{str(path)[:200]}: cannot be looked for: {error}") from None
