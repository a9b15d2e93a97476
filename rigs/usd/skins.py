"""Skeletons and blend shapes of a stage, evaluated by UsdSkel; bindings that it would ignore are repaired."""

from dataclasses import dataclass

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from rigs.usd.stage_clock import UnusableStageError

BINDING = ("skel:skeleton", "skel:animationSource", "skel:blendShapeTargets", "primvars:skel:jointIndices")
PROXIES = Usd.TraverseInstanceProxies()
ADDED_SKELETON = "riginv_skeleton"


@dataclass(frozen=True)
class Skin:
    """The skin of a mesh.

    Attributes:
        query: joint influences and blend shape names.
        skeleton: the bound skeleton, with its animation.
        placed: the prim with the transform of the skeleton; that of `skeleton` may be of an instance's prototype.
        shapes: blend shapes; None: none.
        vertices: indices of the vertices that each blend shape moves.
        offsets: of these vertices, for each shape and in-between.
    """

    query: UsdSkel.SkinningQuery
    skeleton: UsdSkel.SkeletonQuery
    placed: Usd.Prim
    shapes: UsdSkel.BlendShapeQuery | None
    vertices: list
    offsets: list

    @property
    def animation(self) -> UsdSkel.AnimQuery | None:
        """The bound animation, if any."""
        found = self.skeleton.GetAnimQuery()
        return found if found else None

    @property
    def animation_path(self) -> str:
        """Path of the animation, within its instance, if any; else empty."""
        if not self.animation:
            return ""
        source = UsdSkel.BindingAPI(self.placed).GetInheritedAnimationSource()
        return str((source or self.animation.GetPrim()).GetPath())

    @property
    def has_joints(self) -> bool:
        return self.query.HasJointInfluences()

    def attributes(self) -> list[Usd.Attribute]:
        """Attributes that may move the mesh in time, except transforms."""
        query, found = self.query, []
        if self.has_joints:
            primvars = query.GetJointIndicesPrimvar(), query.GetJointWeightsPrimvar()
            found += [query.GetGeomBindTransformAttr(), *(one.GetAttr() for one in primvars)]
        if self.animation:
            moves = UsdSkel.Animation(self.animation.GetPrim())
            if self.has_joints:
                found += [moves.GetTranslationsAttr(), moves.GetRotationsAttr(), moves.GetScalesAttr()]
            if self.shapes:
                found.append(moves.GetBlendShapeWeightsAttr())
        return [attribute for attribute in found if attribute]

    def shaped(self, points: Vt.Vec3fArray, time: float) -> Vt.Vec3fArray:
        """Points `(vertex, 3)` with the blend shapes of a time.

        Raises:
            UnusableStageError: UsdSkel cannot evaluate them.
        """
        if not self.shapes or not self.animation:
            return points
        weights = self.animation.ComputeBlendShapeWeights(time)
        if not weights:
            return points
        mapper = self.query.GetBlendShapeMapper()
        weights = mapper.Remap(weights) if mapper and not mapper.IsIdentity() else weights
        shaped = Vt.Vec3fArray(points)
        if not self.shapes.ComputeDeformedPoints(
            *self.shapes.ComputeSubShapeWeights(weights), self.vertices, self.offsets, shaped
        ):
            raise UnusableStageError(self._failure("blend shapes", time))
        return shaped

    def posed(self, points: Vt.Vec3fArray, time: float) -> Vt.Vec3fArray:
        """Points `(vertex, 3)` of a skinned mesh in the space of its skeleton.

        Raises:
            UnusableStageError: UsdSkel cannot evaluate them.
        """
        joints = self.skeleton.ComputeSkinningTransforms(time)
        if self.query.IsRigidlyDeformed():
            matrix = np.array(self.query.ComputeSkinnedTransform(joints, time), np.float64)
            return Vt.Vec3fArray.FromNumpy((np.array(points) @ matrix[:3, :3] + matrix[3, :3]).astype(np.float32))
        posed = Vt.Vec3fArray(points)
        if joints is None or not self.query.ComputeSkinnedPoints(joints, posed, time):
            raise UnusableStageError(self._failure("skin", time))
        return posed

    def _failure(self, what: str, time: float) -> str:
        return f"UsdSkel cannot evaluate the {what} of {self.query.GetPrim().GetPath()} at time code {time:g}: export it again"


class Skins:
    """Skins of a stage, by mesh."""

    def __init__(self, stage: Usd.Stage) -> None:
        self._cache = UsdSkel.Cache()
        self._populated: set[Sdf.Path] = set()
        self._skeletons: dict[Sdf.Path, tuple[UsdSkel.SkeletonQuery, Usd.Prim]] = {}
        self._stage = stage

    def of(self, mesh: Usd.Prim) -> Skin | None:
        """The skin of a mesh, if any."""
        root = outermost_root(mesh)
        if root is None:
            return None
        if root.GetPath() not in self._populated:
            self._populate(UsdSkel.Root(root))
        query, bound = self._cache.GetSkinningQuery(mesh), self._skeletons.get(mesh.GetPath())
        if bound is None or not query or not (query.HasBlendShapes() or query.HasJointInfluences()):
            return None
        if not query.HasBlendShapes():
            return Skin(query, *bound, None, [], [])
        shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(mesh))
        return Skin(query, *bound, shapes, shapes.ComputeBlendShapePointIndices(), shapes.ComputeSubShapePointOffsets())

    def _populate(self, root: UsdSkel.Root) -> None:
        self._populated.add(root.GetPath())
        self._cache.Populate(root, PROXIES)
        for binding in self._cache.ComputeSkelBindings(root, PROXIES):
            bound = self._cache.GetSkelQuery(binding.GetSkeleton()), binding.GetSkeleton().GetPrim()
            for query in binding.GetSkinningTargets():
                self._skeletons[query.GetPrim().GetPath()] = bound


def outermost_root(prim: Usd.Prim) -> Usd.Prim | None:
    """The outermost SkelRoot above a prim, if any."""
    found = None
    while prim and not prim.IsPseudoRoot():
        found = prim if prim.IsA(UsdSkel.Root) else found
        prim = prim.GetParent()
    return found


def repair_bindings(stage: Usd.Stage, prims: list[Usd.Prim]) -> list[str]:
    """Repair bindings that UsdSkel would ignore, in the session layer, which is never saved.

    Returns:
        Notes, one for each kind of repair.
    """
    bound = [prim.GetPath() for prim in prims if any(prim.HasProperty(name) for name in BINDING)]
    notes = []
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for repair in (_apply_schemas, _add_roots, _add_skeletons):
            notes += repair(stage, [stage.GetPrimAtPath(path) for path in bound])
    return notes


def editable(prim: Usd.Prim) -> Usd.Prim:
    """The prim made editable, by making the instances above it non-instanceable."""
    stage, path = prim.GetStage(), prim.GetPath()
    while stage.GetPrimAtPath(path).IsInstanceProxy():
        above = stage.GetPrimAtPath(path).GetParent()
        while not above.IsInstance():
            above = above.GetParent()
        editable(above).SetInstanceable(False)
    return stage.GetPrimAtPath(path)


def _apply_schemas(stage: Usd.Stage, bound: list[Usd.Prim]) -> list[str]:
    lacking = [prim.GetPath() for prim in bound if not prim.HasAPI(UsdSkel.BindingAPI)]
    for path in lacking:
        UsdSkel.BindingAPI.Apply(editable(stage.GetPrimAtPath(path)))
    if not lacking:
        return []
    return [f"{lacking[0]} is bound to a skeleton without SkelBindingAPI, as in files before 2021: it was read all the same."]


def _add_roots(stage: Usd.Stage, bound: list[Usd.Prim]) -> list[str]:
    rootless = [prim.GetPath() for prim in bound if prim.IsA(UsdGeom.Mesh) and outermost_root(prim) is None]
    rootless = [path for path in rootless if path.pathElementCount > 1]
    for top in {path.GetPrefixes()[0] for path in rootless}:
        stage.GetPrimAtPath(top).SetTypeName("SkelRoot")
    if not rootless:
        return []
    return [f"{rootless[0]} is bound to a skeleton and lies below no SkelRoot, which USD demands: it was posed all the same."]


def _add_skeletons(stage: Usd.Stage, bound: list[Usd.Prim]) -> list[str]:
    """Add a skeleton without joints for meshes that have blend shapes and an animation."""
    repaired: list[Sdf.Path] = []
    for mesh in [prim.GetPath() for prim in bound if prim.IsA(UsdGeom.Mesh) and prim.HasProperty("skel:blendShapeTargets")]:
        prim = stage.GetPrimAtPath(mesh)
        binding, root = UsdSkel.BindingAPI(prim), outermost_root(prim)
        animation = binding.GetInheritedAnimationSource()
        if binding.GetInheritedSkeleton() or not animation or root is None:
            continue
        source, path = animation.GetPath(), editable(root).GetPath().AppendChild(f"{ADDED_SKELETON}_{len(repaired)}")
        skeleton = UsdSkel.Skeleton.Define(stage, path)
        UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([source])
        UsdSkel.BindingAPI(editable(stage.GetPrimAtPath(mesh))).CreateSkeletonRel().SetTargets([path])
        repaired.append(mesh)
    if not repaired:
        return []
    return [f"{repaired[0]} has blend shapes and an animation, but no skeleton, which USD demands: it was shaped all the same."]
