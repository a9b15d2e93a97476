"""python -m riginv.reproduce: the paper's tables, figures and claims, judged, from one command."""

import time

from omegaconf import DictConfig
from rich.console import Console

from riginv.clips.description_text import show_clip
from riginv.config.validation import validate
from riginv.launch.command import command, run_directory
from riginv.reproduce.cast import rig_in_space
from riginv.reproduce.expected import measured
from riginv.reproduce.plan import Plan, open_ended, trainings
from riginv.reproduce.preflight import (
    check_budget,
    check_capture,
    check_folder,
    check_rig,
    choose_true_rig,
    code_of,
    find_folder,
)
from riginv.reproduce.report import write_report
from riginv.reproduce.running import Runner, duration, jobs_here, one_thread
from riginv.reproduce.steps import Graph
from riginv.runs.run_folder import plain_config


def reproduce(config: DictConfig) -> None:
    """Run all steps that are not kept yet, and leave `report.html`, `tables.json` and `tables.md` behind.

    All that can be wrong is looked at first; the expected time is measured and said; then the steps run.
    """
    began = time.monotonic()
    plain = plain_config(config)
    validate(plain)
    check_budget(plain["budget"])
    jobs = jobs_here(plain.pop("jobs"))
    folder, note = find_folder(run_directory(), plain, config.resume)
    say = Console(stderr=True, highlight=False, soft_wrap=True).print

    rig = rig_in_space(plain["rig"])
    capture, meshes = check_capture(plain, rig.rig)
    check_rig(plain["body"])
    judge, judge_name, why_itself = choose_true_rig(plain["true_rig"], rig.rig)
    if why_itself:
        say(f"The programmatic rig judges itself: {why_itself}.", markup=False)
    show_clip(meshes)
    plan = Plan(plain, judge, capture, jobs)
    check_folder(folder, rig, plain["budget"], sum(step.work == "train" for step in plan.steps))
    with one_thread():
        plan.expect(measured(trainings(plain["budget"], plain["rig"]), rig))
    graph = Graph(plan.steps, folder.path / "steps", *code_of(rig.rig, [plain["rig"], plain["body"], judge]))
    if stale := graph.stale_steps():
        say(f"{len(stale)} kept steps are of another version of riginv or of what it builds on, and will be made anew.")

    if note:
        say(note, markup=False)
    runner = Runner(graph, jobs)
    expected_s = sum(graph.steps[name].expected_s for name in runner.left) / jobs
    word = "at least" if any(open_ended(step) for step in plan.steps) else "about"
    say(f"{len(graph.steps)} steps, {jobs} beside each other: {word} {duration(expected_s)}, by training steps measured here.")
    try:
        runner.run()
    except KeyboardInterrupt:
        say(f"Stopped with {len(runner.left)} of {len(graph.steps)} steps left: the same command goes on from here.")
        raise SystemExit(130) from None
    write_report(folder.path, plain, plan, graph, judge_name, why_itself, jobs, time.monotonic() - began)


if __name__ == "__main__":
    command("reproduce")(reproduce)()
