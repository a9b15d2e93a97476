"""From the config of riginv.invert to the parts of an inversion: each is built once."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from riginv.clips.clip import Clip
from riginv.errors import InputError
from riginv.inference.inverse import Inverse
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.weighed_prior import WeighedPrior
from riginv.tracking.alternation import WindowInverter
from riginv.tracking.anchors import Anchors
from riginv.tracking.constraints import ControlConstraints, resolve_constraints
from riginv.tracking.estimators import NetworkEstimator, SolverEstimator
from riginv.tracking.fixed_controls import FixedControlsRig
from riginv.tracking.frame_evaluation import FrameEvaluator
from riginv.tracking.penalties import PenalisedObjective
from riginv.tracking.priors.files import load_prior
from riginv.tracking.priors.prior import independent_measurements
from riginv.tracking.regions import label, regions_of, vertex_weights, weighted_space
from riginv.tracking.rigid_check import anchors_if_moving
from riginv.tracking.stability import TrainingRange, has_root_controls, stability_weights
from riginv.tracking.static_controls import static_values

NETWORK, REFINED, EACH_FRAME, WHOLE_CLIP = "network", "refined", "levenberg_marquardt", "clip"
METHODS = (NETWORK, REFINED, EACH_FRAME, WHOLE_CLIP)
MOTIONS = ("auto", "remove", "keep")
REFINE_STEPS = 5  # of method=refined, where nothing is said

Config = Mapping[str, Any]


@dataclass(frozen=True)
class Parts:
    """What an inversion needs.

    Attributes:
        clip: what is inverted.
        inverter, judge: of windows.
        method: which of METHODS.
        notes: what was guessed or found out, for the user.
    """

    clip: Clip
    inverter: WindowInverter
    judge: FrameEvaluator
    method: str
    notes: list[str]


def resolve_method(config: Config) -> str:
    """The method that a config names, or the one that goes with what it has.

    Raises:
        InputError: there is none of that name, or it lacks what it needs.
    """
    method, bundle, refine = config["method"], config["bundle"], config["refine"]
    if method is None:
        method = WHOLE_CLIP if not bundle else REFINED if refine else NETWORK
    if method not in METHODS:
        raise InputError(f"method is {method!r}, expected one of {', '.join(METHODS)}")
    if method in (NETWORK, REFINED) and not bundle:
        raise InputError(f"method={method} needs a trained network: give bundle=DIR, or method={WHOLE_CLIP} without one")
    if refine and method in (NETWORK, EACH_FRAME):
        raise InputError(f"refine={refine} is for method={REFINED} or {WHOLE_CLIP}: leave it out with method={method}")
    return method


def build_parts(config: Config, clip: Clip, rig: LinearRig, true_rig: RigBackend, inverse: Inverse | None) -> Parts:
    """The parts of an inversion.

    Args:
        rig: what is solved through; that of the inverse, where there is one.

    Raises:
        InputError: a value is wrong, or the method cannot do what is asked of it.
    """
    method, notes = resolve_method(config), []
    constraints = resolve_constraints(rig, config["controls"])
    weights = vertex_weights(true_rig, *(config["vertices"][key] for key in ("weights", "regions", "default")))
    if method == NETWORK:
        _refuse_for_network(constraints, config)
    space = inverse.network.rig.space if inverse else MeshSpace.from_rig(rig)
    in_space = inverse.network.rig if inverse else RigInMeshSpace(rig, space)
    anchors = _anchors(config["motion"], in_space, true_rig, weights, notes)
    by_solver = REFINED if inverse else EACH_FRAME
    if anchors is not None and config["motion"] == "auto":
        solving = build_solver(config, in_space, constraints, weights, inverse, by_solver)
        anchors = anchors_if_moving(clip, rig, solving, anchors, weights, config["turns"], notes)
    if bool(constraints.static.any()):
        solving = build_solver(config, in_space, constraints, weights, inverse, by_solver)
        inverter = WindowInverter(rig, solving, anchors, None, config["turns"])
        constraints = constraints.with_fixed(constraints.static, static_values(clip, inverter, solving, constraints.static))
    solving = (
        NetworkEstimator(inverse, constraints)
        if method == NETWORK
        else build_solver(config, in_space, constraints, weights, inverse, method)
    )
    inverter = WindowInverter(rig, solving, anchors, weights if method == NETWORK else None, config["turns"])
    judge = FrameEvaluator(
        len(clip),
        true_rig,
        rig,
        space,
        solving,
        TrainingRange(in_space) if inverse else None,
        None if weights is None else weights > 0,
        label(regions_of(true_rig), len(rig.rest_vertices)),
        **config["flags"],
    )
    return Parts(clip, inverter, judge, method, notes)


def _refuse_for_network(constraints: ControlConstraints, config: Config) -> None:
    key = constraints.only_of_solvers or ("solver.sparsity" if config["solver"]["sparsity"] else "")
    if key:
        raise InputError(f"{key} is for solvers, and method={NETWORK} is none: add refine=5, or method={WHOLE_CLIP}")


def _anchors(
    motion: Any, rig: RigInMeshSpace, true_rig: RigBackend, weights: Tensor | None, notes: list[str]
) -> Anchors | None:
    """What rigid motion is told by; None where that is left to the rig's own controls."""
    if motion not in MOTIONS:
        raise InputError(f"motion is {motion!r}, expected one of {', '.join(MOTIONS)}")
    if motion == "auto" and has_root_controls(rig):
        notes.append(
            f"rigid motion is left to the controls of rig '{rig.rig.name}' that move all of it (motion=remove takes it out)"
        )
        return None
    if motion == "keep":
        return None
    still = stability_weights(true_rig)
    return Anchors(rig.rig, still if weights is None else still * weights)


def build_solver(
    config: Config,
    rig: RigInMeshSpace,
    constraints: ControlConstraints,
    weights: Tensor | None,
    inverse: Inverse | None,
    method: str,
) -> SolverEstimator:
    """The solver of a method, over the controls that are free.

    Args:
        weights: of the vertices, `(vertex,)`; None: all count alike.
        inverse: whose answers it starts from; None: it starts from scratch.
    """
    options = config["solver"]
    held = FixedControlsRig(rig.rig, constraints.free.nonzero()[:, 0], constraints.held)
    space = rig.space if weights is None else weighted_space(rig.rig, weights)
    objective = PenalisedObjective(
        RigInMeshSpace(held, space),
        options["prior"],
        options["sparsity"],
        constraints.penalties_of_free(),
        _learned(config, rig, held, weights),
    )
    network = NetworkEstimator(inverse, constraints) if inverse is not None and method != EACH_FRAME else None
    steps = (config["refine"] or REFINE_STEPS) if network else options["steps"]
    return SolverEstimator(objective, network, steps, options["key_starts"], options["descent_steps"])


def _learned(config: Config, rig: RigInMeshSpace, held: FixedControlsRig, weights: Tensor | None) -> WeighedPrior | None:
    """The prior that a config names, among the free controls, as it counts beside the vertices that are believed."""
    if config.get("prior") is None:
        return None
    rest = rig.rig.rest_vertices if weights is None else rig.rig.rest_vertices[weights > 0]
    measurements = independent_measurements(rest.cpu())
    return load_prior(Path(str(config["prior"])), rig.rig).of(held.free.cpu()).weighed(config["noise_mm"], measurements)
