"""The rigs of a command, and the clip that it evaluates on, from its config."""

from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.performance import simulated_performance
from riginv.config.building import ClassSpec
from riginv.config.typed import MeshSpaceConfig
from riginv.errors import InputError
from riginv.evaluation.results import check_same_controls, make_true_rig
from riginv.rig.black_box import BlackBoxRig
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet, StoredMeshes

FEW_POSES, FRAMES_TO_A_POSE = 20, 4.5  # below so many poses a simulated performance has so many frames to each


def build_rig(spec: ClassSpec[RigBackend], mesh_space: MeshSpaceConfig, store: str | None = None) -> LinearRig:
    """The rig to train on or to solve through; one that does not end in a linear map gets a basis fitted to random poses.

    Args:
        store: of poses of the rig, whose basis is taken instead; None: poses are sampled.

    Raises:
        InputError: it cannot be built or posed.
    """
    rig = spec.build()
    if isinstance(rig, LinearRig):
        return rig
    if store:
        from riginv.sampling.store.training import rig_of_store  # zarr takes half a second, and most rigs need none

        return rig_of_store(store, rig)
    return BlackBoxRig.sampled(rig, mesh_space.samples, mesh_space.residual_mm)


def build_true_rig(spec: ClassSpec[RigBackend] | None, rig: RigBackend) -> RigBackend:
    """The rig that evaluates: the one that the config names, or what a surrogate was trained on, or the rig itself.

    Raises:
        InputError: it cannot be built, or has other controls or vertices than the rig.
    """
    if spec is not None:
        return make_true_rig(spec, rig)
    true_rig = rig.true_rig()
    check_same_controls(rig, true_rig)
    return true_rig


def build_clip(
    capture: str | None,
    reading: ReadingOptions,
    frames: FrameOptions,
    rig: LinearRig,
    true_rig: RigBackend,
    poses: int | None = None,
) -> MeshSet | None:
    """The clip to evaluate on: the one given, or else the rig's own motion, or a simulated performance; None where it has none.

    Args:
        poses: in each random test set; below 20 a simulated performance has 4.5 frames to each. None: all of its frames.

    Raises:
        InputError: the clip cannot be read or is none of the rig, or the rig's motion holds what is no number.
    """
    if capture:
        from riginv.tracking.capture import open_capture  # with all readers, which most trainings need none of

        return open_capture(capture, true_rig if true_rig.held_out is None else rig, rig, reading, frames)
    motion = true_rig.motion()
    if motion is None:
        most = round(FRAMES_TO_A_POSE * poses) if poses is not None and poses < FEW_POSES else None
        return simulated_performance(true_rig, most=most)
    broken = (~motion.vertices.isfinite().all(dim=2).all(dim=1)).nonzero()[:, 0]
    if len(broken):
        raise InputError(
            f"rig '{true_rig.name}': frame {int(broken[0])} of its motion '{motion.name}' holds NaN or infinite values"
        )
    return StoredMeshes(motion.name, motion.vertices, motion.fps)
