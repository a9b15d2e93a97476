"""From a config to the graph of steps, and to the rows of the tables that they fill."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from riginv.reproduce.recipes import (
    ITSELF,
    Config,
    method_config,
    network_settings,
    test_samples,
    through_surrogate,
    training_config,
)
from riginv.reproduce.sets import CAPTURE_KEYS, CAPTURED, CLIP, COMBINATIONS, POSES
from riginv.reproduce.steps import Step

NETWORK = {"_target_": "riginv.methods.network.Network"}
SETS = (COMBINATIONS, CAPTURED, POSES)  # of Table 2
ALL = (*SETS, CLIP)
START_S, TRAINING_S, DRAWING_S = 2.0, 6.0, 12.0  # what a step takes beside its work
MESH_S = {"judge": 0.03, "network": 0.002, "optimum": 0.05, "direct": 0.07, "clip": 0.04}  # seconds a mesh


@dataclass(frozen=True)
class Row:
    """What fills a row of the tables: for each seed a step that answers, and one that judges.

    Attributes:
        label: as the tables name it.
        answers, results: names of steps, one for each seed, or one alone where nothing was learned.
        seeds: of what was learned; empty where nothing was.
    """

    label: str
    answers: list[str] = field(default_factory=list)
    results: list[str] = field(default_factory=list)
    seeds: list[int] = field(default_factory=list)


class Plan:
    """The steps of a reproduction.

    Args:
        config: the plain config of `riginv.reproduce`.
        judge: the config of the rig that judges.
        capture: the hash of the clip's content, or None where none is given.
        jobs: steps beside each other.

    Attributes:
        steps: in an order in which they can be run.
        rows: by key.
    """

    def __init__(self, config: Config, judge: Config, capture: str | None, jobs: int) -> None:
        self.budget, self.rig, self.body, self.judge = config["budget"], config["rig"], config["body"], judge
        self.seeds: list[int] = self.budget["seeds"]
        self.variants: dict[str, Any] = self.budget["variants"] or {}
        self.sets = {"meshes": self.budget["meshes"], "frames": self.budget["frames"], "capture": capture}
        self.places = {**{key: config[key] for key in CAPTURE_KEYS}, "jobs": jobs}
        self.steps: list[Step] = []
        self.rows: dict[str, Row] = {}
        self._sample()
        self._networks()
        self._solvers()
        self._variants()
        self._measures()
        self._figures()

    def expect(self, step_s: Mapping[str, float]) -> None:
        """Reckon what trainings will take: `step_s` is what a training step takes, s, by the name of its network."""
        for number, step in enumerate(self.steps):
            if step.work == "train":
                network = step.name.partition("-seed")[0]
                variant = self.variants.get(step.name.removeprefix("variant-"), {})
                pace = 3 * step_s["best"] if network == "body" else step_s[variant.get("of", network)]
                expected_s = TRAINING_S + pace * expected_steps(step.config["training"])
                self.steps[number] = replace(step, expected_s=expected_s)

    def _add(self, name: str, work: str, expected_s: float, inputs: Mapping[str, str], about: str = "", **config: Any) -> str:
        given = {"rig": self.rig, "sets": self.sets, **config}
        self.steps.append(Step(name, work, given, dict(inputs), self.places, expected_s, about))
        return name

    def _sample(self) -> None:
        count = test_samples(self.budget)
        about = f"{count:,} random poses, a tenth of {self.budget['samples']:,}, posed by the judge"
        self._add("sample", "sample", START_S + MESH_S["judge"] * count, {}, about, judge=self.judge, poses=count)
        self._add("agree-programmatic", "agree", START_S, {"poses": "sample"}, "the programmatic rig against the judge")

    def _networks(self) -> None:
        labels = {"inverse": "inverse, programmatic rig", "trained": "inverse, trained rig", "holden": "Holden", "best": "ours"}
        for seed in self.seeds:
            self.train("surrogate", seed)
            inputs = {"surrogate": f"surrogate-seed{seed}", "poses": "sample"}
            self._add(f"agree-surrogate-seed{seed}", "agree", START_S, inputs, "a trained rig against the judge")
        for name, label in labels.items():
            self.rows[name] = Row(label, seeds=self.seeds)
            for seed in self.seeds:
                network = self.train(name, seed)
                self._row(name, f"{name}-seed{seed}", NETWORK, "network", ALL, {"network": network}, seed)

    def train(self, name: str, seed: int, more: Sequence[str] = (), step: str | None = None) -> str:
        """A step that trains a network of the budget, with more settings."""
        of = "inverse" if name == "trained" else name
        config = training_config([*network_settings(self.budget, of), *more], self.rig, seed)
        inputs = {"surrogate": f"surrogate-seed{seed}"} if name == "trained" else {}
        steps = config["trainer"]["max_steps"]
        return self._add(
            step or f"{name}-seed{seed}",
            "train",
            TRAINING_S,
            inputs,
            f"{steps:,} steps" if steps else "until the learning rate has fallen",
            training=through_surrogate(config) if inputs else config,
        )

    def _row(
        self,
        row: str,
        step: str,
        method: Mapping[str, Any],
        pace: str,
        sets: Sequence[str],
        inputs: Mapping[str, str],
        seed: int,
        judge: Config | None = None,
    ) -> None:
        """Steps that answer and that judge, for one seed of a row."""
        meshes, frames = self.budget["meshes"], self.budget["frames"] or 4000
        asked = sum(frames if name == CLIP else meshes for name in sets)
        answer, judging = f"answer-{step}", f"judge-{step}"
        given = {"method": dict(method), "answers": list(sets), "seed": seed}
        self._add(answer, "answer", START_S + MESH_S[pace] * asked, {"poses": "sample", **inputs}, "", **given)
        judge = self.judge if judge is None else judge
        judge_s = START_S + (MESH_S["judge"] if judge["_target_"] else 0.002) * meshes * len(sets)
        self._add(judging, "judge", judge_s, {"answer": answer, "poses": "sample"}, "", judge=judge)
        self.rows[row].answers.append(answer)
        self.rows[row].results.append(judging)

    def _solvers(self) -> None:
        first = self.seeds[0]
        optimum = method_config("levenberg_marquardt", **self.budget["optimum"])
        alone = {
            "optimum": ("optimum", optimum, "optimum", ALL),
            "neutral": ("neutral", method_config("neutral"), "network", ALL),
        }
        alone["direct"] = ("direct, programmatic rig", method_config("direct"), "direct", (CLIP,))
        alone["clip"] = ("whole-clip solver", method_config("clip"), "clip", (CLIP,))
        for name, (label, method, pace, sets) in alone.items():
            self.rows[name] = Row(label)
            self._row(name, name, method, pace, sets, {}, first)
        for name in self.budget["others"]:
            self.rows[name] = Row(name.replace("_", " "))
            self._row(name, name, method_config(name), "clip", (CLIP,), {}, first)
        self.rows["direct_trained"] = Row("direct, trained rig", seeds=self.seeds)
        for seed in self.seeds:
            through = {"surrogate": f"surrogate-seed{seed}"}
            self._row("direct_trained", f"direct-trained-seed{seed}", method_config("direct"), "direct", (CLIP,), through, seed)

    def _variants(self) -> None:
        first = self.seeds[0]
        for name, variant in self.variants.items():
            network = self.train(variant["of"], first, variant["settings"], f"variant-{name}")
            if variant["of"] == "surrogate":
                self._add(f"agree-{name}", "agree", START_S, {"surrogate": network, "poses": "sample"})
                continue
            self.rows[name] = Row(name.replace("_", " "), seeds=[first])
            self._row(name, f"variant-{name}", NETWORK, "network", ALL, {"network": network}, first, ITSELF)

    def _measures(self) -> None:
        first = self.seeds[0]
        for name, network in (("inverse", f"inverse-seed{first}"), ("noisy", "variant-noisy")):
            if network in {step.name for step in self.steps}:
                self._add(f"lipschitz-{name}", "lipschitz", START_S, {"network": network}, "", seed=first)
        for name in ("inverse", "holden", "best"):
            inputs = {"answer": f"answer-{name}-seed{first}", "poses": "sample"}
            self._add(f"controls-{name}", "controls", START_S, inputs)

    def _figures(self) -> None:
        first = self.seeds[0]
        shown = [name for name, row in self.rows.items() if name not in self.variants]
        pairs = {self.rows[name].label: list(zip(self.rows[name].answers, self.rows[name].results)) for name in shown}
        read = {step: step for uses in pairs.values() for pair in uses for step in pair}
        self._add("figure-roughness", "plot_roughness", START_S, read, rows=pairs)
        learned = {name: self.rows[name].label for name in ("inverse", "trained", "holden", "best")}
        self._columns("figure-curves", "plot_curves", {f"{name}-seed{first}": label for name, label in learned.items()})
        measured = {f"controls-{name}": learned[name] for name in ("inverse", "holden", "best")}
        self._columns("figure-controls", "plot_controls", measured)
        judged = {f"judge-{name}-seed{first}": label for name, label in learned.items()} | {"judge-optimum": "optimum"}
        self._add(
            "figure-maps", "draw_maps", DRAWING_S, {use: use for use in judged}, columns=judged, sets=[CAPTURED, COMBINATIONS]
        )
        best = {"network": f"best-seed{first}"}
        self._add("figure-denoising", "draw_denoising", DRAWING_S, best, judge=self.judge)
        if self.body["_target_"]:
            self._body(first)

    def _columns(self, name: str, work: str, labels: Mapping[str, str]) -> None:
        inputs = {use: use for use in labels}
        self._add(name, work, START_S, inputs, columns={label: use for use, label in labels.items()})

    def _body(self, seed: int) -> None:
        config = training_config(network_settings(self.budget, "body"), self.body, seed)
        steps = config["trainer"]["max_steps"]
        given = {"rig": self.body, "training": config}
        places = {**self.places, "capture": None}
        sets = {**self.sets, "capture": None}
        self.steps.append(Step("body", "train", given, {}, places, TRAINING_S, f"{steps or 0:,} steps"))
        given = {"rig": self.body, "sets": sets, "judge": self.judge}
        self.steps.append(Step("figure-body", "draw_body", given, {"network": "body"}, places, DRAWING_S))


def trainings(budget: Mapping[str, Any], rig: Mapping[str, Any]) -> dict[str, Config]:
    """A config of each network that is trained, by name: what the expected time is measured on."""
    names = ("surrogate", "inverse", "holden", "best")
    return {name: training_config(network_settings(budget, name), rig, budget["seeds"][0]) for name in names}


def open_ended(step: Step) -> bool:
    """Whether a step trains until its schedule ends it."""
    return step.work == "train" and step.config["training"]["trainer"]["max_steps"] is None


def expected_steps(config: Config) -> int:
    """The steps that a training takes; where a plateau schedule ends it, the fewest that it can take."""
    if config["trainer"]["max_steps"]:
        return config["trainer"]["max_steps"]
    schedule, rate, halvings = config["model"]["schedule"], config["model"]["optimizer"]["lr"], 0
    while rate >= config["stop_below_lr"]:
        rate, halvings = rate * schedule["factor"], halvings + 1
    return halvings * (schedule["patience"] + 1) * config["data"]["steps_per_epoch"]
