"""Default selection of the meshes of a scene, and several as one, for workers that read scenes (without Blender or riginv)."""

from typing import Any

import numpy as np

LISTED = 12
MOST_LISTED = 1000  # meshes that a refused choice hands on
Faces = tuple[np.ndarray, np.ndarray]  # corners of each face, and the vertices at them


def choose_meshes(shown: list[Any], moving: list[Any], vertex_count: int | None, notes: list[str]) -> list[Any]:
    """The only mesh that moves, or the one mesh, or all together, that have the vertices of a rig.

    Args:
        shown: visible meshes, each with `path` and `vertex_count`.
        moving: those of them that move.
        vertex_count: of the rig that the clip is for, where it is known.
        notes: receives a note on the selection.

    Returns:
        Meshes in the order of `shown`; empty: the selection is not clear.
    """
    pools = [pool for pool in (moving, shown) if pool]
    for pool in pools:
        found = _fitting(pool, vertex_count)
        if found:
            if len(pool) > 1 and (len(found) < len(pool) or len(pool) < len(shown)):
                notes.append(_how_chosen(found, pool is moving, vertex_count))
            return found
    return pools[0] if pools and len(pools[0]) == 1 else []


def joined(shapes: list[Faces], counts: list[int]) -> Faces:
    """The faces of meshes with so many vertices as those of one mesh; damaged corners below 0 stay below."""
    before = np.cumsum(counts) - counts
    corners = [np.where(own < 0, own, own + start) for (_, own), start in zip(shapes, before)]
    return np.concatenate([sizes for sizes, _ in shapes]), np.concatenate(corners)


def unclear(meshes: list[Any], moving: list[Any]) -> str:
    """The message for a selection that is not clear, with the names to choose from."""
    which = "those that move" if len(moving) > 1 else "its meshes"
    return (
        f"expected one mesh, choose with reading.mesh=NAME or reading.mesh=[NAME,NAME]; {which} are: "
        f"{listing([f'{mesh.path} ({mesh.vertex_count} vertices)' for mesh in (moving if len(moving) > 1 else meshes)])}"
    )


def listing(names: list[str]) -> str:
    """As `riginv.errors.listed`, which Blender's Python cannot import."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more if names else "none"


def _fitting(pool: list[Any], vertex_count: int | None) -> list[Any]:
    single = [mesh for mesh in pool if mesh.vertex_count == vertex_count]
    if len(single) == 1:
        return single
    return pool if len(pool) > 1 and sum(mesh.vertex_count for mesh in pool) == vertex_count else []


def _how_chosen(found: list[Any], moving: bool, vertex_count: int | None) -> str:
    which = f"{found[0].path} has" if len(found) == 1 else f"{len(found)} meshes together have"
    among = "the meshes that move" if moving else "its meshes"
    return f"Of {among}, {which} the rig's {vertex_count} vertices: read (reading.mesh=... reads others)."
