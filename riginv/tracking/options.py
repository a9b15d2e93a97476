"""Settings of an inversion; `InvertConfig` adds what a command needs, and conf/invert.yaml explains each key."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

from riginv.config.values import Bound, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from riginv.errors import InputError

SOLVE = "solve"  # actor.neutral, in place of a file
Method = Literal["network", "refined", "levenberg_marquardt", "clip"]
Globs = Annotated[Sequence[str], Bound("a list of names or globs, such as [jaw*]", lambda value: True)]
Frames = Annotated[Sequence[int | str], Bound("a list of frames, such as [1,120-135]", lambda value: True)]
Pairs = Annotated[
    Sequence[tuple[str, str]],
    Bound("pairs of names, such as [[browDownLeft,browDownRight]]", lambda value: all(len(pair) == 2 for pair in value)),
]
Penalty = Annotated[float, Bound("a number from 0 to 1e12", lambda value: 0 <= value <= 1e12)]
Weight = Annotated[float, Bound("a weight from 0 to 1e6", lambda value: 0 <= value <= 1e6)]


@dataclass(frozen=True)
class VertexOptions:
    """Weights of vertices.

    Attributes:
        weights: weight by region or glob of regions; later ones override earlier ones.
        default: weight of all other vertices.
        regions: further regions: a name, and a file of vertex indices (.txt, .json, .npy) or of all vertices' weights (.npy).
    """

    weights: Mapping[str, Weight] | None = None
    default: Weight = 1.0
    regions: Mapping[str, str] | None = None


@dataclass(frozen=True)
class ControlOptions:
    """Constraints on controls; all names may be globs.

    Attributes:
        activate: controls that may move.
        freeze: controls that stay at neutral.
        hold: values at which controls are fixed.
        static: controls with one value for the whole clip.
        weights: penalty scale, which multiplies `solver.prior` and `solver.sparsity`.
        symmetric: pairs that move alike; `auto`: all that differ only in their side.
        exclusive: pairs of which at most one moves.
        symmetric_mm2, exclusive_mm2: mean squared error that a violation by a whole range costs.
        mask: file of names and weights: 0 freezes a control, 1 frees it (.json, .yaml, .csv).
        unknown: policy for names that do not match: `error`, `ignore_new`, `ignore_missing`, `ignore_both`.
    """

    activate: Globs = ("*",)
    freeze: Globs = ()
    hold: Mapping[str, float] | None = None
    static: Globs = ()
    weights: Mapping[str, Penalty] | None = None
    symmetric: Literal["auto"] | Pairs = ()
    symmetric_mm2: Weight = 1.0
    exclusive: Literal["auto"] | Pairs = ()
    exclusive_mm2: Weight = 1.0
    mask: str | None = None
    unknown: Literal["error", "ignore_new", "ignore_missing", "ignore_both"] = "error"


@dataclass(frozen=True)
class ActorOptions:
    """The actor, where its face at rest is not the rig's.

    Attributes:
        neutral: file of its neutral, a mesh of the rig's topology or a scan; `solve`: found together with the controls.
        neutral_frames: frames of the clip at which the actor is neutral; their mean is taken.
        landmarks: of a scan as neutral: a map of markers with the position of each in the scan.
        scale: size of its displacements relative to the rig's.

    Raises:
        InputError: both neutrals are given, or landmarks or a scale without one.
    """

    neutral: str | None = None
    neutral_frames: Frames = ()
    landmarks: str | None = None
    scale: Annotated[float, Bound("a factor from 0.2 to 5", lambda value: 0.2 <= value <= 5)] = 1.0

    def __post_init__(self) -> None:
        if self.neutral and self.neutral_frames:
            raise InputError(f"actor.neutral={self.neutral} and actor.neutral_frames are both given: leave one of them out")
        if self.landmarks and self.neutral in (None, "", SOLVE):
            raise InputError(f"actor.landmarks={self.landmarks} are those of a scan: give actor.neutral=SCAN beside it")
        if self.scale != 1 and not self.is_given:
            raise InputError(f"actor.scale={self.scale:g} needs a neutral: give actor.neutral or actor.neutral_frames")

    @property
    def is_given(self) -> bool:
        """Whether the actor differs from the rig."""
        return bool(self.neutral or self.neutral_frames)


@dataclass(frozen=True)
class LandmarkOptions:
    """Landmarks of scans.

    Attributes:
        map: file with their places on the rig's surface, as for markers.
        clip: take of their positions in the scans' space: .c3d, .trc or .csv.
        weight: of their mean squared distance at the widest robust scale, relative to that of the surface; it falls with the
            scale.

    Raises:
        InputError: only one of the files is given.
    """

    map: str | None = None
    clip: str | None = None
    weight: PositiveFloat = 1.0

    def __post_init__(self) -> None:
        if bool(self.map) != bool(self.clip):
            given, lacking = ("map", "clip") if self.map else ("clip", "map")
            path = self.map or self.clip
            raise InputError(f"landmarks.{given}={path} needs landmarks.{lacking}=FILE beside it: add it, or leave both out")

    @property
    def is_given(self) -> bool:
        """Whether there are landmarks."""
        return bool(self.map)


@dataclass(frozen=True)
class SolverOptions:
    """Settings of the solver.

    Attributes:
        steps: linearisations of each frame, at most, without a network.
        prior: mm^2 of mean squared error for a control that leaves neutral by its whole range.
        sparsity: the same as an L1 penalty.
        fewer_controls: whether `with_fewer_controls` follows; with `method=clip` before the curves are smoothed.
        smoothness: of `method=clip`: mm^2 for a second difference of a whole range.
        full_smoothness_mm: of `method=clip`: as in `solve_clip`.
        clip_steps: of `method=clip`: Gauss-Newton steps on the whole clip.
        mean_steps: of `method=clip`: further steps that minimise distances in place of their squares.
        blur: of `method=clip`: standard deviation, in frames, of the smoothing of the initial curves.
        key_starts, descent_steps: starts of every fourth frame, and gradient descent steps to the second of them.
    """

    steps: PositiveInt = 30
    prior: NonNegativeFloat = 1e-6
    sparsity: NonNegativeFloat = 0.0
    fewer_controls: bool = False
    smoothness: NonNegativeFloat = 1.5
    full_smoothness_mm: NonNegativeFloat = 0.02
    clip_steps: PositiveInt = 4
    mean_steps: NonNegativeInt = 0
    blur: NonNegativeFloat = 3.0
    key_starts: PositiveInt = 2
    descent_steps: NonNegativeInt = 60


@dataclass(frozen=True)
class FlagOptions:
    """When a frame is flagged: distance from what the rig can make, and from what the network was trained on, mm."""

    reach_mm: PositiveFloat = 1.0
    range_mm: PositiveFloat = 0.5


@dataclass(frozen=True)
class AfterOptions:
    """Processing of the curves: frames per second, key reduction within mm, exchange of MouthLeft and MouthRight."""

    fps: PositiveFloat | None = None
    keys_mm: PositiveFloat | None = None
    swap_mouth: bool = False


@dataclass(frozen=True)
class LookOptions:
    """The views of the result that are written: the HTML page, the contact sheet, TensorBoard events."""

    page: bool = True
    sheet: bool = True
    tensorboard: bool = False


@dataclass(frozen=True, kw_only=True)
class TrackingOptions:
    """Options of inverting a clip.

    Attributes:
        method: None: the network of a bundle, else `clip`.
        correspondence: `vertices`: the rig's own mesh; `surface`: scans of any topology; `markers`: markers on its surface;
            `auto`: vertices where they fit.
        markers: file with the places of markers on the rig's surface.
        prior: folder of a learned prior; None: for scans and markers a default prior, else none.
        noise_mm: standard deviation of the residual between a capture and the rig's best mesh, which weights the prior; None:
            0.1, or 0.3 for markers.
        refine: Levenberg-Marquardt steps after the network.
        mean_steps: steps on the mean vertex distance after the network, once rigid motion is known.
        motion: rigid motion: `remove`, `keep`, or `auto`: remove it, unless the rig has controls for it.
        iterations: iterations of the alternating solve for rigid motion, missing vertices and controls, at most.
        actor: the actor, where its face at rest is not the rig's.
        landmarks: of scans.
        window: frames in memory at a time.

    Raises:
        InputError: the method does not fit `refine`.
    """

    method: Method | None = None
    correspondence: Literal["auto", "vertices", "surface", "markers"] = "auto"
    markers: str | None = None
    prior: str | None = None
    noise_mm: PositiveFloat | None = None
    refine: NonNegativeInt = 0
    mean_steps: NonNegativeInt = 0
    motion: Literal["auto", "remove", "keep"] = "auto"
    iterations: PositiveInt = 12
    actor: ActorOptions = field(default_factory=ActorOptions)
    landmarks: LandmarkOptions = field(default_factory=LandmarkOptions)
    vertices: VertexOptions = field(default_factory=VertexOptions)
    controls: ControlOptions = field(default_factory=ControlOptions)
    solver: SolverOptions = field(default_factory=SolverOptions)
    flags: FlagOptions = field(default_factory=FlagOptions)
    window: PositiveInt = 128

    def __post_init__(self) -> None:
        if self.refine and self.method in ("network", "levenberg_marquardt"):
            raise InputError(f"refine={self.refine} is for method=refined or clip: leave it out with method={self.method}")
        if self.mean_steps and (self.refine or self.method not in (None, "network")):
            raise InputError(f"mean_steps={self.mean_steps} is for method=network: leave it out with a solver")
        if self.markers is not None and self.correspondence != "markers":
            raise InputError(f"markers={self.markers} is for correspondence=markers: add that, or leave it out")
        if self.landmarks.is_given and self.correspondence in ("vertices", "markers"):
            raise InputError(f"landmarks are for correspondence=surface, not {self.correspondence}: leave landmarks.* out")

    @property
    def noise_of_measurements_mm(self) -> float:
        """`noise_mm`, or its default."""
        return self.noise_mm or (0.3 if self.correspondence == "markers" else 0.1)

    def refuse_options_of_meshes(self, setting: str) -> None:
        """Raise InputError for `solver.fewer_controls` or a `method` that is for meshes of the rig's own topology alone."""
        if self.solver.fewer_controls:
            raise InputError(f"solver.fewer_controls is for meshes of the rig's own topology, not {setting}: leave it out")
        if self.method not in (None, "clip", "levenberg_marquardt"):
            raise InputError(f"method={self.method} is not for {setting}: leave it out, or method=levenberg_marquardt")

    def resolved_method(self, has_network: bool) -> Method:
        """The method, or the default one for what is given.

        Raises:
            InputError: the method needs a network, and there is none.
        """
        if self.method in ("network", "refined") and not has_network:
            raise InputError(f"method={self.method} needs a trained network: give bundle=DIR, or method=clip without one")
        if self.mean_steps and not has_network:
            raise InputError(f"mean_steps={self.mean_steps} needs a trained network: give bundle=DIR")
        if self.method is not None:
            return self.method
        return "clip" if not has_network else "refined" if self.refine else "network"
