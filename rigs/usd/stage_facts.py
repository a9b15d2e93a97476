"""Facts about a stage for the user: animations, resting skeletons, hidden meshes, variants."""

import numpy as np
from pxr import Usd

from rigs.blender.in_blender.mesh_choice import joined, listing
from rigs.usd.choice import StageContents
from rigs.usd.posed_mesh import PosedMesh

MOST_LOOKS = 10_000  # frames in which visibility is checked
MOST_VARIANT_SETS = 3


def animations(contents: StageContents, meshes: list[PosedMesh]) -> tuple[list[str], list[str]]:
    """Paths of the SkelAnimations that move the meshes, and of the others."""
    bound = {mesh.skin.animation_path for mesh in meshes if mesh.skin}
    paths = [str(path) for path in contents.animation_paths]
    return [path for path in paths if path in bound], [path for path in paths if path not in bound]


def notes_of_skins(meshes: list[PosedMesh], others: list[str]) -> list[str]:
    """Skeletons without animation, and animations that move nothing."""
    notes = []
    resting = [mesh for mesh in meshes if mesh.skin and not mesh.skin.animation]
    if resting:
        more = f" (reading.animation=NAME binds one of {listing(others)})" if others else ""
        notes.append(f"The skeleton of {resting[0].path} is bound to no SkelAnimation and stays at rest{more}.")
    elif others and any(mesh.skin for mesh in meshes):
        notes.append(f"SkelAnimations that were passed over: {listing(others)} (reading.animation=NAME binds another).")
    moving = [mesh for mesh in meshes if mesh.points_are_ignored()]
    if moving:
        notes.append(
            f"The points of {moving[0].path} have time samples, and UsdSkel poses those without a time: they were passed over."
        )
    unskinned = [mesh for mesh in meshes if mesh.skin is None and mesh.prim.HasProperty("skel:skeleton")]
    if unskinned:
        notes.append(f"{unskinned[0].path} names a skeleton that poses nothing of it: it was read as a mesh without skin.")
    return notes


def notes_of_visibility(meshes: list[PosedMesh], times: np.ndarray) -> list[str]:
    """Meshes that are hidden in some frames."""
    notes = []
    for mesh in meshes:
        hidden = mesh.hidden_times(times[:MOST_LOOKS])
        if len(hidden):
            notes.append(
                f"{mesh.path} is invisible in {len(hidden)} frames, the first at time code {hidden[0]:g}: read all the same."
            )
    return notes


def notes_of_variants(stage: Usd.Stage, meshes: list[PosedMesh]) -> list[str]:
    """Variant sets at or above the meshes, since the stage's own selection is what is read."""
    found = {}
    for mesh in meshes:
        for path in mesh.prim.GetPath().GetPrefixes():
            sets = stage.GetPrimAtPath(path).GetVariantSets()
            for name in sets.GetNames():
                one = sets.GetVariantSet(name)
                others = [other for other in one.GetVariantNames() if other != one.GetVariantSelection()]
                if others:
                    found[f"{path}{{{name}}}"] = one.GetVariantSelection() or "none", others
    return [
        f"Of variant set {name} the stage selects {selected!r}, which was read, not {listing(others)}."
        for name, (selected, others) in list(found.items())[:MOST_VARIANT_SETS]
    ]


def faces(meshes: list[PosedMesh]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of each face, and the vertices at them, of all meshes as one."""
    return joined([mesh.faces(mesh.first_time) for mesh in meshes], [mesh.vertex_count for mesh in meshes])
