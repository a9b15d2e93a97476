"""The report: one page that opens anywhere, the figures as JSON, and the tables as Markdown."""

import base64
import datetime
from pathlib import Path
from typing import Any

import yaml
from jinja2 import Environment, PackageLoader, StrictUndefined
from rich.console import Console

from riginv.reproduce import measures as paper
from riginv.reproduce.claims import claims
from riginv.reproduce.machine import hardware, versions
from riginv.reproduce.pictures import PICTURE
from riginv.reproduce.plan import Plan
from riginv.reproduce.preflight import TrueRigChoice
from riginv.reproduce.running import duration
from riginv.reproduce.settings import ReproduceConfig
from riginv.reproduce.steps import Graph
from riginv.reproduce.tables import Results, orderings, table_1, table_2, table_3
from riginv.reproduce.wording import markdown_tables, shown, terminal_tables, with_spread
from riginv.runs.files import write_json, write_text
from riginv.runs.run_folder import METRICS

HTML, JSON, MARKDOWN = "report.html", "tables.json", "tables.md"
FIGURES = {
    "figure-denoising": "Denoising: a random combination of blendshapes, which the rig cannot reach, beside the true rig, "
    "posed by its inverse, and the difference.",
    "figure-body": "The body: frames of an animation beside the poses recovered by an inverse, and the difference.",
    "figure-roughness": "Error against roughness on the clip, for all methods; lower left is better.",
    "figure-curves": "Validation errors over the training of the first seed, evaluated by the programmatic rig.",
    "figure-maps": "The mean error of each vertex on the rest mesh. Each row has its own scale of red.",
    "figure-controls": "The error of each control on random poses of the rig, against its effect on the vertices. "
    "Controls with a small effect may be inexact: the paper's section on the distribution of parameters.",
}


def write_report(
    folder: Path,
    config: dict[str, Any],
    settings: ReproduceConfig,
    plan: Plan,
    graph: Graph,
    true_rig: TrueRigChoice,
    seconds: float,
) -> None:
    """Write `tables.json`, `tables.md`, `report.html`, and last `metrics.json`, and print the tables.

    Args:
        config: plain, shown as it is.
        seconds: duration of this run of the command.
    """
    budget = settings.budget
    results = Results(plan, graph, "capture" if settings.capture else "simulated_performance")
    spent = {name: graph.seconds(name) for name in graph.steps}
    about = {
        "paper": paper.TITLE,
        "budget": budget.name,
        "budget_about": budget.about,
        "judge": true_rig.name,
        "evaluated_by_itself": true_rig.why_itself,
        "captured_data": Path(settings.capture).name if settings.capture else "simulated: no recording was given",
        "seeds": list(plan.seeds),
        "made": datetime.datetime.now().astimezone().isoformat(timespec="minutes"),
        "versions": versions(),
        "hardware": hardware(),
        "jobs": plan.context.jobs,
        "this_run_s": round(seconds, 1),
        "all_steps_s": round(sum(spent.values()), 1),
    }
    tables = {"table1": table_1(results), "table2": table_2(results), "table3": table_3(results)}
    tested = {"orderings": orderings(results), "claims": claims(results)}
    write_json(folder / JSON, {"about": about, **tables, **tested})
    write_text(folder / MARKDOWN, markdown_tables(about, tables))
    page = _template().render(
        about=about,
        **tables,
        **tested,
        figures=[(name, text, _inlined(graph.path(name) / PICTURE)) for name, text in FIGURES.items() if name in graph.steps],
        paper_rig=paper.RIG,
        config=yaml.safe_dump(config, sort_keys=False),
        steps=[(name, graph.steps[name].about, f"{seconds:.1f}") for name, seconds in spent.items()],
        budget=budget,
        spent=duration(sum(spent.values())),
        took=duration(seconds),
    )
    write_text(folder / HTML, page)
    metrics = {
        f"{row['row']} {row.get('set', 'rig_poses')}/mean_vertex_error_mm": row["mean_vertex_error_mm"]
        for row in _errors(tables)
    }
    write_json(folder / METRICS, metrics)
    _show(folder, about, tables, tested)


def _errors(tables: dict[str, list[dict[str, Any]]]) -> list[dict[str, Any]]:
    return [*tables["table1"], *tables["table2"]]


def _template() -> Any:
    environment = Environment(
        loader=PackageLoader("riginv.reproduce", "templates"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters |= {"shown": shown, "with_spread": with_spread}
    return environment.get_template("report.html")


def _inlined(picture: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(picture.read_bytes()).decode()}"


def _show(folder: Path, about: dict[str, Any], tables: dict[str, Any], tested: dict[str, Any]) -> None:
    console = Console()
    console.print(terminal_tables(about, tables), markup=False, highlight=False, soft_wrap=True)
    for ordering in tested["orderings"]:
        colour, word = ("green", "holds") if ordering["holds"] else ("red", "does not hold")
        console.print(f"  [{colour}]{word}[/]  {ordering['ordering']}", highlight=False, soft_wrap=True)
    console.print()
    for claim in tested["claims"]:
        console.print(f"  {claim['verdict']:10}  {claim['claim']}", highlight=False, soft_wrap=True, markup=False)
    console.print()
    for what, name in (("the report", HTML), ("all figures", JSON), ("tables to paste", MARKDOWN)):
        console.print(f"  {what + ':':17} {folder / name}", soft_wrap=True, highlight=False, markup=False)
