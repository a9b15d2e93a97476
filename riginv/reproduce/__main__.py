"""python -m riginv.reproduce: the tables, figures and claims of the paper."""

from riginv.launch.command import answer_help, command, run_directory

answer_help(__name__, "reproduce")  # before the imports that take seconds

import time

from omegaconf import DictConfig
from rich.console import Console

from riginv.clips.description_text import show_clip
from riginv.config.typed import to_typed
from riginv.reproduce.expected import measured
from riginv.reproduce.plan import Plan, is_open_ended, timed_trainings
from riginv.reproduce.preflight import check_capture, check_folder, choose_true_rig, code_hashes, find_folder
from riginv.reproduce.report import write_report
from riginv.reproduce.rigs import rig_in_space
from riginv.reproduce.running import Runner, duration, jobs_here
from riginv.reproduce.sets import CaptureSource
from riginv.reproduce.settings import ReproduceConfig
from riginv.reproduce.steps import Graph
from riginv.reproduce.training import TrainNetwork
from riginv.runs.run_folder import plain_config
from riginv.runs.threads import single_threaded


def reproduce(config: DictConfig) -> None:
    """Run the unfinished steps, and write `report.html`, `tables.json` and `tables.md`.

    Inputs are checked and the expected time is printed before the first step.
    """
    began = time.monotonic()
    settings = to_typed(config, ReproduceConfig)
    plain = {key: value for key, value in plain_config(config).items() if key != "jobs"}
    jobs = jobs_here(settings.jobs)
    folder, note = find_folder(run_directory(), plain, settings.resume)
    say = Console(stderr=True, highlight=False, soft_wrap=True).print

    rig = rig_in_space(settings.rig)
    capture, meshes = check_capture(CaptureSource(settings.capture, settings.reading, settings.frames), rig.source)
    if settings.body is not None:
        settings.body.build()  # refuses early
    true_rig = choose_true_rig(settings.true_rig, rig.source)
    if true_rig.why_itself:
        say(f"The programmatic rig evaluates itself: {true_rig.why_itself}.", markup=False)
    show_clip(meshes)
    plan = Plan(settings, true_rig.spec, capture, jobs)
    check_folder(folder, rig, settings.budget, sum(isinstance(step.task, TrainNetwork) for step in plan.steps))
    with single_threaded():
        plan.expect(measured(timed_trainings(settings.budget, settings.rig), rig))
    graph = Graph(plan.steps, folder.path / "steps", *code_hashes(rig.source, [settings.rig, settings.body, true_rig.spec]))
    if stale := graph.stale_steps():
        say(f"{len(stale)} kept steps are of another version of riginv or of its libraries, and are run again.")

    if note:
        say(note, markup=False)
    runner = Runner(graph, jobs)
    expected_s = sum(graph.steps[name].expected_s for name in runner.remaining) / jobs
    word = "at least" if any(is_open_ended(step) for step in plan.steps) else "about"
    say(f"{len(graph.steps)} steps, {jobs} in parallel: {word} {duration(expected_s)}, by training steps timed here.")
    try:
        runner.run()
    except KeyboardInterrupt:
        remaining = f"{len(runner.remaining)} of {len(graph.steps)} steps remain"
        raise KeyboardInterrupt(f"{remaining}; the same command goes on with them") from None
    write_report(folder.path, plain, settings, plan, graph, true_rig, time.monotonic() - began)


if __name__ == "__main__":
    command("reproduce")(reproduce)()
