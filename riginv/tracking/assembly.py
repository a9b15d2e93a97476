"""The parts of an inversion, built from its options."""

from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from riginv.clips.clip import Clip
from riginv.errors import InputError
from riginv.inference.inverse import Inverse
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.objective import GaussianPrior
from riginv.tracking.actors.actor import Actor, ActorRig, posed_actor
from riginv.tracking.alternation import WindowInverter
from riginv.tracking.anchors import Anchors
from riginv.tracking.constraints import ControlConstraints, resolve_constraints
from riginv.tracking.estimators import ControlEstimator, NetworkEstimator, SolverEstimator
from riginv.tracking.fixed_controls import FixedControlsRig
from riginv.tracking.frame_evaluation import FrameEvaluator
from riginv.tracking.options import Method, SolverOptions, TrackingOptions
from riginv.tracking.penalties import PenalisedObjective
from riginv.tracking.priors.files import load_prior
from riginv.tracking.priors.prior import independent_measurements
from riginv.tracking.regions import label, regions_of, vertex_weights, weighted_space
from riginv.tracking.rigid_check import anchors_if_moving
from riginv.tracking.stability import TrainingRange, has_root_controls, stability_weights
from riginv.tracking.static_controls import static_values

REFINE_STEPS = 5  # of method=refined without refine=


@dataclass(frozen=True)
class Parts:
    """The parts of an inversion.

    Attributes:
        clip: to invert.
        inverter, evaluator: work window by window.
        method: the resolved method.
        notes: what was guessed or found out, for the user.
    """

    clip: Clip
    inverter: WindowInverter
    evaluator: FrameEvaluator
    method: Method
    notes: list[str]


def build_parts(
    options: TrackingOptions,
    clip: Clip,
    rig: LinearRig,
    true_rig: RigBackend,
    inverse: Inverse | None,
    actor: Actor | None = None,
) -> Parts:
    """The parts of an inversion.

    Args:
        rig: to solve for; that of the inverse, if there is one.
        actor: whose neutral takes the place of the rig's; None: the actor's face at rest is the rig's.

    Raises:
        InputError: a name or file is wrong, or the method cannot do what is requested.
    """
    method = options.resolved_method(inverse is not None)
    notes: list[str] = []
    constraints = resolve_constraints(rig, options.controls)
    weights = vertex_weights(true_rig, options.vertices)
    if method == "network":
        _refuse_for_network(constraints, options.solver)
    if options.mean_steps and weights is not None:
        raise InputError("mean_steps counts all vertices alike: leave it out with vertices.*, or add refine=5 in its place")
    plain_rig, evaluated_rig = rig, true_rig
    space = inverse.network.rig.space if inverse else MeshSpace.from_rig(rig)
    in_space = inverse.network.rig if inverse else RigInMeshSpace(rig, space)
    if actor is not None:
        rig = ActorRig(rig, actor)
        evaluated_rig = rig if true_rig is plain_rig else posed_actor(true_rig, actor)
        space = MeshSpace(rig.rest_vertices, space.directions, space.residual_mm)
        in_space = RigInMeshSpace(rig, space)
    anchors = _anchors(options.motion, in_space, true_rig, weights, notes)
    by_solver: Method = "refined" if inverse else "levenberg_marquardt"
    if anchors is not None and options.motion == "auto":
        solver = build_solver(options, in_space, constraints, weights, inverse, by_solver, plain_rig)
        anchors = anchors_if_moving(clip, rig, solver, anchors, weights, options.iterations, notes)
    if bool(constraints.static.any()):
        solver = build_solver(options, in_space, constraints, weights, inverse, by_solver, plain_rig)
        inverter = WindowInverter(rig, solver, anchors, None, options.iterations)
        constraints = constraints.with_fixed(constraints.static, static_values(clip, inverter, solver, constraints.static))
    estimator: ControlEstimator
    if method == "network" and inverse is not None:
        estimator = NetworkEstimator(inverse, constraints, in_space, options.mean_steps)
    else:
        estimator = build_solver(options, in_space, constraints, weights, inverse, method, plain_rig)
    inverter = WindowInverter(rig, estimator, anchors, weights if method == "network" else None, options.iterations)
    evaluator = FrameEvaluator(
        len(clip),
        evaluated_rig,
        rig,
        space,
        estimator,
        TrainingRange(in_space) if inverse else None,
        None if weights is None else weights > 0,
        label(regions_of(true_rig), len(rig.rest_vertices)),
        options.flags,
    )
    return Parts(clip, inverter, evaluator, method, notes)


def _refuse_for_network(constraints: ControlConstraints, solver: SolverOptions) -> None:
    given = {"solver.sparsity": solver.sparsity, "solver.fewer_controls": solver.fewer_controls}
    key = constraints.solver_only or next((key for key, value in given.items() if value), "")
    if key:
        raise InputError(f"{key} is for solvers, and method=network is none: add refine=5, or method=clip")


def _anchors(
    motion: str, rig: RigInMeshSpace, true_rig: RigBackend, weights: Tensor | None, notes: list[str]
) -> Anchors | None:
    """The vertices that rigid motion is estimated from; None where the rig's own controls make it, or it is kept."""
    if motion == "keep":
        return None
    if motion == "auto" and has_root_controls(rig):
        notes.append(
            f"rigid motion is left to the controls of rig '{rig.source.name}' that move all of it (motion=remove takes it out)"
        )
        return None
    stability = stability_weights(true_rig)
    return Anchors(rig.source, stability if weights is None else stability * weights)


def build_solver(
    options: TrackingOptions,
    rig: RigInMeshSpace,
    constraints: ControlConstraints,
    weights: Tensor | None,
    inverse: Inverse | None,
    method: Method,
    prior_rig: LinearRig | None = None,
) -> SolverEstimator:
    """The solver of a method, over the free controls.

    Args:
        weights: of the vertices, `(vertex,)`; None: all count equally.
        inverse: its answers are the start; None: the solver starts from scratch.
        prior_rig: the rig that a learned prior belongs to; None: that of `rig`.
    """
    solver = options.solver
    fixed = FixedControlsRig(rig.source, constraints.free.nonzero()[:, 0], constraints.values)
    space = (
        rig.space if weights is None else weighted_space(rig.source, weights / weights.mean())
    )  # so that priors keep their size
    objective = PenalisedObjective(
        RigInMeshSpace(fixed, space),
        solver.prior,
        solver.sparsity,
        constraints.penalties_of_free(),
        _learned_prior(options, prior_rig or rig.source, fixed, weights),
    )
    network = NetworkEstimator(inverse, constraints, rig) if inverse is not None and method != "levenberg_marquardt" else None
    steps = (options.refine or REFINE_STEPS) if network else solver.steps
    starts = solver.key_starts, solver.descent_steps
    return SolverEstimator(objective, network, steps, *starts, solver.fewer_controls)


def _learned_prior(
    options: TrackingOptions, rig: LinearRig, fixed: FixedControlsRig, weights: Tensor | None
) -> GaussianPrior | None:
    """The learned prior of the free controls, weighted for the vertices that count."""
    if options.prior is None:
        return None
    rest = rig.rest_vertices if weights is None else rig.rest_vertices[weights > 0]
    measurements = independent_measurements(rest.cpu())
    prior = load_prior(Path(options.prior), rig).subset(fixed.free.cpu())
    return prior.weighed(options.noise_of_measurements_mm, measurements)
