"""Names that a stranger chose, in pages, tables and terminals: they are shown, and do nothing there."""

import base64
import csv
import gzip
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest
import torch

from riginv.animation.table import as_text, write_curves
from riginv.errors import InputError
from riginv.reproduce.report import _template
from riginv.rig.interface import Control
from riginv.runs import tables
from riginv.tracking.viewer.page import write_viewer
from tests.support.animations import errors_of, moving
from tests.support.toys import ToyRig

HOSTILE = (
    "</script><script>window.ran=1</script>",
    "<img src=x onerror=window.ran=1>",
    "\"'><svg/onload=window.ran=1>",
    "/*MESHES*/",
    "/*SCRIPT*/",
    "\\u003c/script>",
    "=cmd|' /C calc'!A0",
    "[/bold]",
)


class Elements(HTMLParser):
    """What a browser would make of a page: its elements, their attributes, and the text of its scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.scripts: dict[str, str] = {}
        self.within = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        self.within = dict(attrs).get("id", "program") if tag == "script" else ""

    def handle_data(self, data):
        if self.within:
            self.scripts[self.within] = self.scripts.get(self.within, "") + data

    def handle_endtag(self, tag):
        self.within = ""


@pytest.mark.parametrize("name", HOSTILE)
def test_no_name_adds_anything_to_the_page_of_an_inversion(tmp_path, name):
    pages = []
    for last in ("harmless", name):
        rig = ToyRig(last_name=last)
        rig.name = last
        animation = replace(moving(rig, with_motion=False), source=last)
        path = tmp_path / "page.html"
        write_viewer(path, animation, errors_of(animation), lambda rows, a=animation: a.rig(a.controls[list(rows)]))
        pages.append(Elements(path.read_text()))
    plain, found = pages
    assert found.tags == plain.tags and found.attributes == plain.attributes and found.scripts.keys() == plain.scripts.keys()
    assert found.scripts["program"] == plain.scripts["program"] and found.scripts["meshes"] == plain.scripts["meshes"]
    facts = json.loads(found.scripts["facts"])
    assert facts["controls"][-1]["name"] == name and facts["source"] == name
    gzip.decompress(base64.b64decode(found.scripts["meshes"]))


def test_the_report_escapes_what_it_is_given():
    assert _template().environment.autoescape is True
    shown = _template().environment.from_string("{{ name }}").render(name=HOSTILE[0])
    assert "<script" not in shown


@pytest.mark.parametrize("name", ["=1+1", "+1", "@SUM(A1)", "-1+cmd", "=HYPERLINK(1)"])
def test_a_spreadsheet_takes_no_name_for_a_formula(tmp_path, name):
    animation = moving(ToyRig(last_name=name), with_motion=False)
    write_curves(tmp_path / "curves.csv", animation)
    rows = list(csv.reader((tmp_path / "curves.csv").open()))
    quoted = name if re.fullmatch(r"[+-]\d+", name) else f"'{name}"
    assert rows[0][-1] == quoted and rows[0][2] == "bump0"
    assert torch.tensor([[float(cell) for cell in row] for row in rows[1:]]).shape == (12, 9)


@pytest.mark.parametrize("number", ["-1.5", "+2", "-1e-07", "1e+20", "nan", "-inf", "jawOpen", "-0"])
def test_numbers_stay_numbers(number):
    assert as_text(number) == number


@pytest.mark.parametrize("name", ["[/]", "[/bold]", "[red]a"])
def test_a_terminal_shows_names_as_they_are(capsys, name):
    metrics = {f"poses/{key}": 1.0 for key, _ in tables.COLUMNS} | {"true_rig": name}
    tables.print_results(metrics, name)
    out = capsys.readouterr().out
    assert f"Evaluated on the true rig, {name}, posed" in out


@pytest.mark.parametrize("name", ["\x1b]0;owned\x07", "a\nb", "\x9b2J", "a\u2028b", "\ud800"])
def test_names_that_would_move_a_cursor_are_refused(name):
    with pytest.raises(InputError, match="printable text"):
        ToyRig(last_name=name)


@pytest.mark.parametrize("name", ["Größe", "口を開く", "a b", "a\u00a0b", "😀", "CTRL_a.001|b:c"])
def test_names_of_any_language_are_welcome(name):
    assert ToyRig(last_name=name).controls[-1] == Control(name)
