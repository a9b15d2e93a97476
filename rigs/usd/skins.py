"""Skeletons and blend shapes of a stage, as usd-core's UsdSkel evaluates them; bindings that it passes over are mended."""

from dataclasses import dataclass

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from rigs.usd.stage_clock import UnusableStageError

BINDING = ("skel:skeleton", "skel:animationSource", "skel:blendShapeTargets", "primvars:skel:jointIndices")
PROXIES = Usd.TraverseInstanceProxies()
MENDED_SKELETON = "riginv_skeleton"


@dataclass(frozen=True)
class Skin:
    """What poses one mesh.

    Attributes:
        query: its joints' influences, and how it names its blend shapes.
        skeleton: the skeleton that it is bound to, with its animation.
        placed: the prim whose transform places the skeleton; within an instance that of `skeleton` may be its prototype's.
        shapes: its blend shapes; None: it has none.
        vertices: that each blend shape moves, one array a shape.
        offsets: of these, one array for each shape and in-between.
    """

    query: UsdSkel.SkinningQuery
    skeleton: UsdSkel.SkeletonQuery
    placed: Usd.Prim
    shapes: UsdSkel.BlendShapeQuery | None
    vertices: list
    offsets: list

    @property
    def animation(self) -> UsdSkel.AnimQuery | None:
        """What is bound to the skeleton; None: nothing, and it stays at rest."""
        found = self.skeleton.GetAnimQuery()
        return found if found else None

    @property
    def animation_path(self) -> str:
        """The path of the animation, within the instance where it is in one; empty: there is none."""
        if not self.animation:
            return ""
        source = UsdSkel.BindingAPI(self.placed).GetInheritedAnimationSource()
        return str((source or self.animation.GetPrim()).GetPath())

    @property
    def has_joints(self) -> bool:
        return self.query.HasJointInfluences()

    def attributes(self) -> list[Usd.Attribute]:
        """Whatever may move the mesh in time, but transforms."""
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
        weights = self.animation.ComputeBlendShapeWeights(time) if self.shapes and self.animation else None
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
    """The skins of a stage, by mesh."""

    def __init__(self, stage: Usd.Stage) -> None:
        self._cache, self._populated = UsdSkel.Cache(), set()
        self._skeletons: dict[Sdf.Path, tuple[UsdSkel.SkeletonQuery, Usd.Prim]] = {}
        self._stage = stage

    def of(self, mesh: Usd.Prim) -> Skin | None:
        """What poses a mesh; None: nothing."""
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
    """The SkelRoot below which a prim is posed; None: there is none."""
    found = None
    while prim and not prim.IsPseudoRoot():
        found = prim if prim.IsA(UsdSkel.Root) else found
        prim = prim.GetParent()
    return found


def mend_bindings(stage: Usd.Stage, prims: list[Usd.Prim]) -> list[str]:
    """Make bindings valid that UsdSkel would pass over, in the session layer, which is never saved.

    Returns:
        What was mended, one sentence for each kind.
    """
    bound = [prim.GetPath() for prim in prims if any(prim.HasProperty(name) for name in BINDING)]
    notes = []
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for mend in (_apply_schemas, _add_roots, _add_skeletons):
            notes += mend(stage, [stage.GetPrimAtPath(path) for path in bound])
    return notes


def editable(prim: Usd.Prim) -> Usd.Prim:
    """A prim that may be changed: what it is a part of is an instance no longer."""
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
    """A skeleton without joints for meshes that have blend shapes and an animation."""
    mended = []
    for place in [prim.GetPath() for prim in bound if prim.IsA(UsdGeom.Mesh) and prim.HasProperty("skel:blendShapeTargets")]:
        prim = stage.GetPrimAtPath(place)
        binding, root = UsdSkel.BindingAPI(prim), outermost_root(prim)
        animation = binding.GetInheritedAnimationSource()
        if binding.GetInheritedSkeleton() or not animation or root is None:
            continue
        source, path = animation.GetPath(), editable(root).GetPath().AppendChild(f"{MENDED_SKELETON}_{len(mended)}")
        skeleton = UsdSkel.Skeleton.Define(stage, path)
        UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([source])
        UsdSkel.BindingAPI(editable(stage.GetPrimAtPath(place))).CreateSkeletonRel().SetTargets([path])
        mended.append(place)
    if not mended:
        return []
    return [f"{mended[0]} has blend shapes and an animation, but no skeleton, which USD demands: it was shaped all the same."]
