"""Figures and tables as text."""

from collections.abc import Mapping, Sequence
from typing import Any

MEAN, MAX = "mean_vertex_error_mm", "max_vertex_error_mm"
ERRORS = ((MEAN, "mean, mm"), (MAX, "maximum, mm"))
TITLES = {
    "table1": "Table 1. Rigs against the true rig, vertex error on random poses",
    "table2": "Table 2. Rig inversion, vertex error",
    "table3": "Table 3. Roughness of the controls on the clip, and the vertex errors that the paper leaves out",
}


def shown(value: float | None, figures: int = 3) -> str:
    """A number in a table; None: `-`."""
    if value is None:
        return "-"
    if value != 0 and abs(value) < 1e-3:
        return f"{value:.{figures - 2}e}"
    return f"{value:.0f}" if abs(value) >= 10**figures else f"{value:.{figures}g}"


def with_spread(row: Mapping[str, Any], key: str) -> str:
    """A figure of a row, with its spread over the seeds where there is one."""
    spread = row[f"{key}_spread"]
    return shown(row[key]) if spread is None else f"{shown(row[key])} ± {shown(spread, 2)}"


Tables = Mapping[str, Sequence[Mapping[str, Any]]]


def markdown_tables(about: Mapping[str, Any], tables: Tables) -> str:
    """The three tables as Markdown, each with a note on the budget and the true rig."""
    parts = [
        part
        for name, rows in tables.items()
        for part in (f"**{TITLES[name]}**", "", *_piped(_lines(name, rows)), "", _note(about), "")
    ]
    return "\n".join(parts)


def terminal_tables(about: Mapping[str, Any], tables: Tables) -> str:
    """The three tables with columns padded to one width, and the note once."""
    titles = {name: f"{TITLES[name]} (budget {about['budget']})" for name in tables}
    parts = [part for name, rows in tables.items() for part in ("", titles[name], *_aligned(_lines(name, rows)))]
    return "\n".join([*parts, "", _note(about), ""])


def _note(about: Mapping[str, Any]) -> str:
    itself = about["evaluated_by_itself"]
    true_rig = f"the programmatic rig itself ({itself})" if itself else about["judge"]
    note = (
        f"Budget {about['budget']}: {about['budget_about']} Evaluated by {true_rig}. Captured data: {about['captured_data']}."
    )
    seeds = f"Mean ± standard deviation over seeds {', '.join(map(str, about['seeds']))}; in brackets what the paper reports."
    return f"{note} {seeds}"


def _lines(name: str, rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    columns = [("roughness", "roughness"), *ERRORS] if name == "table3" else list(ERRORS)
    first = ["set"] if name == "table2" else []
    lines = [[*first, "", *(heading for _, heading in columns)]]
    for row in rows:
        of = [row["set"].replace("_", " ")] if name == "table2" else []
        lines.append([*of, row["label"], *(_beside_paper(row, key) for key, _ in columns)])
    return lines


def _beside_paper(row: Mapping[str, Any], key: str) -> str:
    theirs = row.get(f"paper_{key}")
    return with_spread(row, key) + ("" if theirs is None else f" [{shown(theirs)}]")


def _piped(lines: list[list[str]]) -> list[str]:
    head, *body = ["| " + " | ".join(line) + " |" for line in lines]
    texts = sum(not heading or heading == "set" for heading in lines[0])
    return [head, "|" + "---|" * texts + "---:|" * (len(lines[0]) - texts), *body]


def _aligned(lines: list[list[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*lines)]
    return ["  " + "  ".join(text.ljust(width) for text, width in zip(line, widths)).rstrip() for line in lines]
