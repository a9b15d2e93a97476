"""From a config to the graph of steps, and to the rows of the tables."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from riginv.config.building import ClassSpec
from riginv.methods.base import Method
from riginv.reproduce.evaluation import EvaluateControls, EvaluateRig, SamplePoses
from riginv.reproduce.inversion import InvertSets
from riginv.reproduce.measures import MeasureControls, MeasureLipschitz
from riginv.reproduce.pictures import DrawBody, DrawDenoising, DrawErrorMaps
from riginv.reproduce.plots import PlotControls, PlotRoughness, PlotTraining, Uses
from riginv.reproduce.recipes import method_specs, network_settings, through_surrogate, training_config
from riginv.reproduce.sets import CAPTURED, CLIP, COMBINATIONS, POSES, CaptureSource, SetSizes
from riginv.reproduce.settings import Budget, ReproduceConfig, Variant
from riginv.reproduce.steps import Context, Step, Task
from riginv.reproduce.training import TrainNetwork
from riginv.rig.interface import RigBackend
from riginv.training.config import TrainConfig

NETWORK: ClassSpec[Method] = ClassSpec.read({"_target_": "riginv.methods.network.Network"}, Method)
SETS = (COMBINATIONS, CAPTURED, POSES)  # of Table 2
ALL = (*SETS, CLIP)
START_S, TRAINING_S, DRAWING_S = 2.0, 6.0, 12.0  # of a step, without its work
MESH_S = {"true_rig": 0.03, "network": 0.002, "optimum": 0.05, "direct": 0.07, "clip": 0.04}  # seconds per mesh
ITSELF_S = 0.002  # per mesh, where the programmatic rig evaluates itself
FRAMES = 4000  # that are expected in a clip


@dataclass(frozen=True)
class Row:
    """A row of the tables.

    Attributes:
        label: name in the tables.
        inversions, evaluations: names of steps, one per seed, or one alone where nothing was trained.
        seeds: empty where nothing was trained.
    """

    label: str
    inversions: list[str] = field(default_factory=list)
    evaluations: list[str] = field(default_factory=list)
    seeds: Sequence[int] = ()


class Plan:
    """The steps of a reproduction.

    Args:
        true_rig: None: the programmatic rig.
        capture: hash of the content of the captured data; None: simulated.
        jobs: number of parallel steps.

    Attributes:
        steps: each after those that it reads.
        rows: by key.
    """

    def __init__(
        self, settings: ReproduceConfig, true_rig: ClassSpec[RigBackend] | None, capture: str | None, jobs: int
    ) -> None:
        self.budget, self.rig, self.body, self.true_rig = settings.budget, settings.rig, settings.body, true_rig
        self.seeds = self.budget.seeds
        self.variants: Mapping[str, Variant] = self.budget.variants or {}
        self.sizes = SetSizes(self.budget.meshes, self.budget.frames, capture)
        self.context = Context(CaptureSource(settings.capture, settings.reading, settings.frames), jobs)
        self.steps: list[Step] = []
        self.rows: dict[str, Row] = {}
        self._sample()
        self._networks()
        self._solvers()
        self._variants()
        self._measures()
        self._figures()

    def expect(self, step_s: Mapping[str, float]) -> None:
        """Estimate the duration of trainings.

        Args:
            step_s: seconds per training step, by network.
        """
        for number, step in enumerate(self.steps):
            if isinstance(step.task, TrainNetwork):
                network = step.name.partition("-seed")[0]
                variant = self.variants.get(step.name.removeprefix("variant-"))
                pace = 3 * step_s["best"] if network == "body" else step_s[variant.of if variant else network]
                self.steps[number] = replace(step, expected_s=TRAINING_S + pace * expected_steps(step.task.training))

    def _add(self, name: str, task: Task, expected_s: float, inputs: Mapping[str, str], about: str = "") -> str:
        self.steps.append(Step(name, task, self.context, dict(inputs), expected_s, about))
        return name

    def _sample(self) -> None:
        count = self.budget.test_samples
        about = f"{count:,} random poses of the true rig, a tenth of {self.budget.samples:,}"
        sample = SamplePoses(self.rig, self.sizes, self.true_rig, count)
        self._add("sample", sample, START_S + MESH_S["true_rig"] * count, {}, about)
        compare = EvaluateRig(self.rig, self.sizes)
        self._add("evaluate-programmatic", compare, START_S, {"poses": "sample"}, "the programmatic rig by the true rig")

    def _networks(self) -> None:
        labels = {"inverse": "inverse, programmatic rig", "trained": "inverse, trained rig", "holden": "Holden", "best": "ours"}
        for seed in self.seeds:
            self.train("surrogate", seed)
            inputs = {"surrogate": f"surrogate-seed{seed}", "poses": "sample"}
            compare = EvaluateRig(self.rig, self.sizes)
            self._add(f"evaluate-surrogate-seed{seed}", compare, START_S, inputs, "a trained rig by the true rig")
        for name, label in labels.items():
            self.rows[name] = Row(label, seeds=self.seeds)
            for seed in self.seeds:
                network = self.train(name, seed)
                self._invert(name, f"{name}-seed{seed}", NETWORK, "network", ALL, {"network": network}, seed)

    def train(self, name: str, seed: int, more: Sequence[str] = (), step: str | None = None) -> str:
        """Add a step that trains a network of the budget, with further settings."""
        of = "inverse" if name == "trained" else name
        training = training_config([*network_settings(self.budget, of), *more], self.rig, seed)
        inputs = {"surrogate": f"surrogate-seed{seed}"} if name == "trained" else {}
        task = TrainNetwork(self.rig, self.sizes, through_surrogate(training) if inputs else training)
        steps = training.trainer.max_steps
        about = f"{steps:,} steps" if steps else "until the learning rate has fallen"
        return self._add(step or f"{name}-seed{seed}", task, TRAINING_S, inputs, about)

    def _invert(
        self,
        row: str,
        step: str,
        method: ClassSpec[Method],
        pace: str,
        names: tuple[str, ...],
        inputs: Mapping[str, str],
        seed: int,
        by_itself: bool = False,
    ) -> None:
        """Add the inversion and the evaluation of one seed of a row.

        Args:
            pace: key of `MESH_S`.
            names: of the sets.
            by_itself: whether the programmatic rig evaluates, not the true rig.
        """
        meshes = sum((self.budget.frames or FRAMES) if name == CLIP else self.budget.meshes for name in names)
        inversion, evaluation = f"invert-{step}", f"evaluate-{step}"
        invert = InvertSets(self.rig, self.sizes, method, names, seed)
        self._add(inversion, invert, START_S + MESH_S[pace] * meshes, {"poses": "sample", **inputs})
        true_rig = None if by_itself else self.true_rig
        mesh_s = MESH_S["true_rig"] if true_rig else ITSELF_S
        evaluate = EvaluateControls(self.rig, self.sizes, true_rig)
        reads = {"controls": inversion, "poses": "sample"}
        self._add(evaluation, evaluate, START_S + mesh_s * self.budget.meshes * len(names), reads)
        self.rows[row].inversions.append(inversion)
        self.rows[row].evaluations.append(evaluation)

    def _solvers(self) -> None:
        first = self.seeds[0]
        solvers = ["levenberg_marquardt", "neutral", "direct", "clip", *self.budget.others]
        specs = method_specs(solvers, levenberg_marquardt=self.budget.optimum)
        alone: dict[str, tuple[str, ClassSpec[Method], str, tuple[str, ...]]] = {
            "optimum": ("optimum", specs["levenberg_marquardt"], "optimum", ALL),
            "neutral": ("neutral", specs["neutral"], "network", ALL),
            "direct": ("direct, programmatic rig", specs["direct"], "direct", (CLIP,)),
            "clip": ("whole-clip solver", specs["clip"], "clip", (CLIP,)),
        }
        for name, (label, method, pace, names) in alone.items():
            self.rows[name] = Row(label)
            self._invert(name, name, method, pace, names, {}, first)
        for name in self.budget.others:
            self.rows[name] = Row(name.replace("_", " "))
            self._invert(name, name, specs[name], "clip", (CLIP,), {}, first)
        self.rows["direct_trained"] = Row("direct, trained rig", seeds=self.seeds)
        for seed in self.seeds:
            surrogate = {"surrogate": f"surrogate-seed{seed}"}
            step = f"direct-trained-seed{seed}"
            self._invert("direct_trained", step, specs["direct"], "direct", (CLIP,), surrogate, seed)

    def _variants(self) -> None:
        first = self.seeds[0]
        for name, variant in self.variants.items():
            network = self.train(variant.of, first, variant.settings, f"variant-{name}")
            if variant.of == "surrogate":
                compare = EvaluateRig(self.rig, self.sizes)
                self._add(f"evaluate-{name}", compare, START_S, {"surrogate": network, "poses": "sample"})
                continue
            self.rows[name] = Row(name.replace("_", " "), seeds=[first])
            self._invert(name, f"variant-{name}", NETWORK, "network", ALL, {"network": network}, first, by_itself=True)

    def _measures(self) -> None:
        first = self.seeds[0]
        for name, network in (("inverse", f"inverse-seed{first}"), ("noisy", "variant-noisy")):
            if network in {step.name for step in self.steps}:
                measure = MeasureLipschitz(self.rig, self.sizes, first)
                self._add(f"lipschitz-{name}", measure, START_S, {"network": network})
        for name in ("inverse", "holden", "best"):
            inputs = {"controls": f"invert-{name}-seed{first}", "poses": "sample"}
            self._add(f"controls-{name}", MeasureControls(self.rig, self.sizes), START_S, inputs)

    def _figures(self) -> None:
        first, rig, sizes = self.seeds[0], self.rig, self.sizes
        shown = [row for name, row in self.rows.items() if name not in self.variants]
        uses = {row.label: [Uses(*pair) for pair in zip(row.inversions, row.evaluations)] for row in shown}
        read = [step for row in shown for step in (*row.inversions, *row.evaluations)]
        self._add("figure-roughness", PlotRoughness(rig, sizes, uses), START_S, _by_name(read))
        learned = {name: self.rows[name].label for name in ("inverse", "trained", "holden", "best")}
        trained = {label: f"{name}-seed{first}" for name, label in learned.items()}
        self._add("figure-curves", PlotTraining(rig, sizes, trained), START_S, _by_name(trained.values()))
        measured = {learned[name]: f"controls-{name}" for name in ("inverse", "holden", "best")}
        self._add("figure-controls", PlotControls(rig, sizes, measured), START_S, _by_name(measured.values()))
        evaluated = {f"evaluate-{name}-seed{first}": label for name, label in learned.items()} | {"evaluate-optimum": "optimum"}
        maps = DrawErrorMaps(rig, sizes, evaluated, (CAPTURED, COMBINATIONS))
        self._add("figure-maps", maps, DRAWING_S, _by_name(evaluated))
        best = {"network": f"best-seed{first}"}
        self._add("figure-denoising", DrawDenoising(rig, sizes, self.true_rig), DRAWING_S, best)
        if self.body is not None:
            self._body(self.body, first)

    def _body(self, body: ClassSpec[RigBackend], seed: int) -> None:
        training = training_config(network_settings(self.budget, "body"), body, seed)
        context = replace(self.context, capture=CaptureSource())
        sizes = replace(self.sizes, capture=None)
        about = f"{training.trainer.max_steps or 0:,} steps"
        self.steps.append(Step("body", TrainNetwork(body, sizes, training), context, {}, TRAINING_S, about))
        figure = DrawBody(body, sizes, self.true_rig)
        self.steps.append(Step("figure-body", figure, context, {"network": "body"}, DRAWING_S))


def _by_name(steps: Iterable[str]) -> dict[str, str]:
    return {step: step for step in steps}


def timed_trainings(budget: Budget, rig: ClassSpec[RigBackend]) -> dict[str, TrainConfig]:
    """Trainings whose steps are timed for the expected duration, by name."""
    names = ("surrogate", "inverse", "holden", "best")
    return {name: training_config(network_settings(budget, name), rig, budget.seeds[0]) for name in names}


def is_open_ended(step: Step) -> bool:
    """Whether a step trains until its schedule ends."""
    return isinstance(step.task, TrainNetwork) and step.task.training.trainer.max_steps is None


def expected_steps(training: TrainConfig) -> int:
    """Training steps; the least possible number where a plateau schedule ends the training."""
    if training.trainer.max_steps:
        return training.trainer.max_steps
    model, halvings = training.model, 0
    schedule, rate = model.schedule.arguments, model.optimizer.arguments["lr"]
    while training.stop_below_lr is not None and rate >= training.stop_below_lr:
        rate, halvings = rate * schedule["factor"], halvings + 1
    return halvings * (schedule["patience"] + 1) * training.data.steps_per_epoch
