"""Selection of the meshes and animations of a stage."""

from collections.abc import Callable, Sequence

from pxr import Sdf, Usd, UsdGeom, UsdSkel

from rigs.blender.in_blender.mesh_choice import MOST_LISTED, choose_meshes, listing, unclear
from rigs.usd.posed_mesh import PosedMesh
from rigs.usd.skins import PROXIES, Skins, editable
from rigs.usd.stage_clock import UnusableAsClipError, UnusableStageError

MOST_PRIMS = 300_000  # limit for nested instances


class StageContents:
    """Meshes, skeletons and SkelAnimations of a stage, in its order.

    Args:
        stage: the stage; its session layer is modified.
        prims: all prims, including those within instances.
        ragged: whether meshes may change from frame to frame; then point clouds serve where there are no meshes.
    """

    def __init__(self, stage: Usd.Stage, prims: list[Usd.Prim], ragged: bool = False) -> None:
        self.stage, self.ragged = stage, ragged
        self.mesh_paths = [prim.GetPath() for prim in prims if prim.IsA(UsdGeom.Mesh)]
        self.cloud_paths = [prim.GetPath() for prim in prims if prim.IsA(UsdGeom.Points)]
        if ragged and not self.mesh_paths:
            self.mesh_paths = self.cloud_paths
        self.animation_paths = [prim.GetPath() for prim in prims if prim.IsA(UsdSkel.Animation)]
        self.skeleton_paths = [prim.GetPath() for prim in prims if prim.IsA(UsdSkel.Skeleton)]
        self.skins = Skins(stage)

    def mesh(self, path: Sdf.Path) -> PosedMesh:
        prim = self.stage.GetPrimAtPath(path)
        return PosedMesh(prim, self.skins.of(prim), self.ragged)

    def bind_animation(self, requested: str | int) -> None:
        """Bind a SkelAnimation to every skeleton with joints or blend shapes of its names.

        Args:
            requested: path, name, or number from 1.

        Raises:
            UnusableStageError: none or several match, or it fits no skeleton.
        """
        path = self._animation_path(requested)
        moves = UsdSkel.Animation(self.stage.GetPrimAtPath(path))
        names = {*self.joints_of(path), *(moves.GetBlendShapesAttr().Get() or [])}
        skins = [mesh.skin for mesh in map(self.mesh, self.mesh_paths) if mesh.skin]
        fitting = {
            skin.placed.GetPath()
            for skin in skins
            if names & {*skin.skeleton.GetJointOrder(), *(skin.query.GetBlendShapeOrder() or [])}
        }
        fitting |= {skeleton for skeleton in self.skeleton_paths if names & self.joints_of(skeleton)}
        if not fitting:
            raise UnusableStageError(f"reading.animation={requested}: it has no joint or blend shape of a skeleton")
        with Usd.EditContext(self.stage, self.stage.GetSessionLayer()):
            for skeleton in fitting:
                prim = editable(self.stage.GetPrimAtPath(skeleton))
                UsdSkel.BindingAPI.Apply(prim).CreateAnimationSourceRel().SetTargets([path])
        self.skins = Skins(self.stage)

    def joints_of(self, path: Sdf.Path) -> set[str]:
        """Paths of the joints of a skeleton or a SkelAnimation."""
        return {str(joint) for joint in self.stage.GetPrimAtPath(path).GetAttribute("joints").Get() or []}

    def without_meshes(self, notes: Sequence[str]) -> UnusableStageError:
        """The error for a stage that has no mesh."""
        more, kind = "", UnusableStageError
        if self.animation_paths and not self.skeleton_paths:
            more = " It has SkelAnimations and no Skeleton, whose rest pose they need: export both in one stage."
        if self.cloud_paths:
            more, kind = f"{more} It has point clouds: correspondence=surface reads them as scans.", UnusableAsClipError
        elif self.ragged and self.skeleton_paths:
            more = " It has a skeleton, which moves a rig's joints and has no surface: leave out correspondence=surface."
        return kind(f"expected one mesh, and it has none.{more} {' '.join(notes)}".strip())

    def _animation_path(self, requested: str | int) -> Sdf.Path:
        listed = listing([str(path) for path in self.animation_paths])
        number = int(requested) if isinstance(requested, int) or requested.isdecimal() else None
        fitting = [path for path in self.animation_paths if str(requested) in (str(path), path.name)]
        if not fitting and number is not None and 1 <= number <= len(self.animation_paths):
            return self.animation_paths[number - 1]
        if len(fitting) != 1:
            raise UnusableStageError(
                f"reading.animation={requested} names {len(fitting)} of its SkelAnimations, expected one; they are: {listed}"
            )
        return fitting[0]


def all_prims(stage: Usd.Stage) -> list[Usd.Prim]:
    """Prims of a stage, including those within instances.

    Raises:
        UnusableStageError: there are too many.
    """
    found = []
    for prim in Usd.PrimRange.Stage(stage, PROXIES):
        found.append(prim)
        if len(found) > MOST_PRIMS:
            raise UnusableStageError(f"more than {MOST_PRIMS:,} prims, instances counted: damaged, or no single character")
    return found


def chosen_meshes(contents: StageContents, names: Sequence[str], vertex_count: int | None, notes: list[str]) -> list[PosedMesh]:
    """The meshes to read, in the stage's order.

    Args:
        contents: of the stage.
        names: of meshes, or of prims with one mesh each, or their paths; empty: the moving mesh, or meshes that have
            `vertex_count` vertices alone or together.
        vertex_count: of the clip's rig, where known.
        notes: receives a note on the choice.

    Raises:
        UnusableStageError: a name matches none or several, or the choice is ambiguous.
    """
    if names:
        paths = {_named_mesh(contents, name) for name in names}
        return [contents.mesh(path) for path in contents.mesh_paths if path in paths]
    meshes = [contents.mesh(path) for path in contents.mesh_paths]
    shown = [mesh for mesh in meshes if mesh.is_shown()] or meshes
    moving = [mesh for mesh in shown if len(mesh.times) > 1]
    if len(moving) > 1:
        moving = [mesh for mesh in moving if mesh.moves()] or moving
    found = choose_meshes(shown, moving, vertex_count, notes)
    if not found:
        listed = [(mesh.path, mesh.vertex_count, len(mesh.times) if mesh in moving else 1) for mesh in meshes]
        raise UnusableStageError(unclear(meshes, moving), listed[:MOST_LISTED])
    return found


def _named_mesh(contents: StageContents, name: str) -> Sdf.Path:
    """Path of the mesh with a name or path, or below the prim with that name or path."""
    paths = contents.mesh_paths
    tests: tuple[Callable[[Sdf.Path], bool], ...] = (
        lambda path: name in (str(path), path.name),
        lambda path: any(name in (str(above), above.name) for above in path.GetPrefixes()),
    )
    for test in tests:
        fitting = [path for path in paths if test(path)]
        if len(fitting) == 1:
            return fitting[0]
        if fitting:
            break
    raise UnusableStageError(
        f"expected one mesh, reading.mesh={name} names {len(fitting)} of them; its meshes are: "
        f"{listing([str(path) for path in paths])}"
    )
