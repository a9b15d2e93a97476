"""A worker that gives the motion of a skeleton of a USD stage (docs/worker-protocol.md).

PYTHON play_bones.py
"""

import sys
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

sys.path.insert(0, str(Path(__file__).parents[2]))  # where `rigs` is; the worker's own code needs no riginv

from rigs.blender.in_blender.mesh_choice import listing
from rigs.blender.in_blender.worker import serve
from rigs.usd.choice import StageContents
from rigs.usd.frame_grid import frame_grid
from rigs.usd.play_usd import MEMORY, Answer, OpenedStage
from rigs.usd.posed_mesh import sample_times, transform_attributes
from rigs.usd.stage_clock import UnusableStageError

MOST_TRANSFORMS = 5_000_000  # frames times joints


class UsdBones(OpenedStage):
    """Loads a stage, and describes the motion of its animated skeleton."""

    def load(self, file: str, animation: str | int | None = None, fps: float | None = None) -> Answer:
        """Open the stage and choose its skeleton.

        Args:
            file: the stage.
            animation: path, name or number of the SkelAnimation to bind; None: what the stage binds.
            fps: requested frame rate.
        """
        self.open(file)
        with self.refusing("open"):
            if animation is not None:
                self.contents.bind_animation(animation)
            self.skeleton = chosen_skeleton(self.contents, animation is not None, self.notes)
            if self.skeleton is not None:
                self.grid = frame_grid(_samples(self.skeleton), self.clock(fps))
        return {}, {}

    def describe(self) -> Answer:
        """Names, parents, rest and motion of the joints; no names where the stage has no skeleton.

        Transforms of joints are in the world, in the stage's units and axes.
        """
        if self.skeleton is None:
            return {"joints": []}, {}
        query, grid = self.skeleton, self.grid
        moves = str(query.GetAnimQuery().GetPrim().GetPath())
        facts = {
            "joints": [str(joint).rpartition("/")[2] for joint in query.GetJointOrder()],
            "parents": [int(parent) for parent in query.GetTopology().GetParentIndices()],
            "animation": moves,
            "other_animations": [str(path) for path in self.contents.animation_paths if str(path) != moves],
            "fps": grid.fps,
            "rate_source": grid.source,
            "notes": [*self.notes, *grid.notes],
            **self.units(),
        }
        with self.refusing("read"):
            if len(grid.times) * len(facts["joints"]) > MOST_TRANSFORMS:
                raise UnusableStageError(
                    f"{len(grid.times):,} frames of {len(facts['joints']):,} joints, expected at most {MOST_TRANSFORMS:,} "
                    f"transforms: split the take"
                )
            worlds = np.stack([_world(query, float(time)) for time in grid.times])
            rest = _rest(query, float(grid.times[0]))
        return facts, {"frames": grid.numbers, "rest": rest, "worlds": worlds}


def chosen_skeleton(contents: StageContents, requested: bool, notes: list[str]) -> UsdSkel.SkeletonQuery | None:
    """The animated skeleton of a stage; None: it has no skeleton with joints.

    Args:
        contents: of the stage.
        requested: whether the user named the SkelAnimation, which is bound by now.
        notes: receives notes on the choice.

    Raises:
        UnusableStageError: no skeleton is animated, or several are.
    """
    paths = [path for path in contents.skeleton_paths if contents.joints_of(path)]
    if not paths:
        return None
    animated = _animated(contents, paths)
    if not animated:
        joints = {joint for path in paths for joint in contents.joints_of(path)}
        fitting = [path for path in contents.animation_paths if contents.joints_of(path) & joints]
        if len(fitting) != 1:
            unbound = f"{len(fitting)} SkelAnimations have its joints ({listing([str(path) for path in fitting])})"
            raise UnusableStageError(
                f"its skeleton {paths[0]} is bound to no animation, and {unbound}: "
                + ("choose with reading.animation=NAME" if fitting else "export it with one")
            )
        contents.bind_animation(str(fitting[0]))
        notes.append(f"The stage binds {fitting[0]} to no skeleton: it was bound to the one with its joints.")
        animated = _animated(contents, paths)
    sources = {path: str(query.GetAnimQuery().GetPrim().GetPath()) for path, query in animated.items()}
    if len(set(sources.values())) > 1 and not requested:
        raise UnusableStageError(
            f"{len(animated)} of its skeletons are animated, expected one: choose with reading.animation=NAME of "
            f"{listing(list(sources.values()))}"
        )
    if len(animated) > 1:
        notes.append(f"Of its skeletons {listing([str(path) for path in animated])} the first was read.")
    return next(iter(animated.values()))


def _animated(contents: StageContents, paths: list[Sdf.Path]) -> dict[Sdf.Path, UsdSkel.SkeletonQuery]:
    """The skeletons among `paths` whose joints are animated."""
    cache, found = UsdSkel.Cache(), {}
    for path in paths:
        query = cache.GetSkelQuery(UsdSkel.Skeleton(contents.stage.GetPrimAtPath(path)))
        moves = query.GetAnimQuery() if query else None
        if moves and contents.joints_of(moves.GetPrim().GetPath()) & contents.joints_of(path):
            found[path] = query
    return found


def _samples(query: UsdSkel.SkeletonQuery) -> np.ndarray:
    moves = UsdSkel.Animation(query.GetAnimQuery().GetPrim())
    attributes = [moves.GetTranslationsAttr(), moves.GetRotationsAttr(), moves.GetScalesAttr()]
    attributes = [*filter(None, attributes), *transform_attributes(query.GetPrim())]
    if not any(attribute.GetNumTimeSamples() or attribute.HasSpline() for attribute in attributes):
        raise UnusableStageError(
            f"{moves.GetPath()} has no time samples of joints, and its skeleton is never moved: export its animation"
        )
    return sample_times(attributes)


def _world(query: UsdSkel.SkeletonQuery, time: float) -> np.ndarray:
    """World transforms `(joint, 3, 4)` of the joints at a time."""
    joints = query.ComputeJointSkelTransforms(time)
    if joints is None:
        raise UnusableStageError(f"UsdSkel cannot evaluate {query.GetPrim().GetPath()} at time code {time:g}: export it again")
    return _columns(np.array(joints, np.float64) @ _placed(query, time))


def _rest(query: UsdSkel.SkeletonQuery, time: float) -> np.ndarray:
    """World transforms `(joint, 3, 4)` at rest: those to which meshes are bound, else the rest transforms.

    USD defines bind transforms in the world; some exporters write them in the skeleton's own space.
    """
    placed, count = _placed(query, time), len(query.GetJointOrder())
    resting = query.ComputeJointSkelTransforms(Usd.TimeCode.Default(), atRest=True) if query.HasRestPose() else None
    at_rest = None if resting is None else np.array(resting, np.float64) @ placed
    bound = np.array(query.GetJointWorldBindTransforms() or [], np.float64).reshape(-1, 4, 4)
    if len(bound) == count and (at_rest is None or np.ptp(bound[:, 3, :3], axis=0).any()):
        candidates = [bound, bound @ placed]
        return _columns(bound if at_rest is None else min(candidates, key=lambda one: float(np.abs(one - at_rest).sum())))
    if at_rest is None:
        raise UnusableStageError(
            f"{query.GetPrim().GetPath()} has neither bindTransforms nor restTransforms of its {count} joints: export it again"
        )
    return _columns(at_rest)


def _placed(query: UsdSkel.SkeletonQuery, time: float) -> np.ndarray:
    return np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(query.GetPrim()), np.float64)


def _columns(matrices: np.ndarray) -> np.ndarray:
    """Matrices for column vectors `(joint, 3, 4)` from USD's for row vectors `(joint, 4, 4)`."""
    return np.ascontiguousarray(matrices[..., :3].swapaxes(-1, -2))


if __name__ == "__main__":
    serve(UsdBones(MEMORY))
