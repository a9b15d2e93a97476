"""What the README and the docs say can be typed works."""

import re
import subprocess
from pathlib import Path

import pytest

from riginv.launch.command import true_rig_choice
from tests.conftest import ROOT
from tests.training.test_experiments import composed

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SETUP = "python3 -m venv .venv && . .venv/bin/activate"
MAIN = f"{SETUP} && pip install . && python -m riginv.train rig=face model=inverse"
TESTS = f"{SETUP} && pip install -e '.[test]' && python -m pytest"


def commands(page: Path) -> list[str]:
    """The command lines of riginv in a page."""
    text = page.read_text(encoding="utf-8")
    return sorted({line.strip("`").strip() for line in re.findall(r"python -m riginv\.[a-z_]+[^\n`|#]*", text)})


def test_the_two_commands_are_there_each_with_its_setup():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert MAIN in text and TESTS in text
    gate = (ROOT / ".ci/run").read_text()
    assert "pip install --quiet --editable '.[test]'" in gate and "python -m pytest" in gate


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_composes(page):
    for command in commands(page):
        if "--config-dir" in command or "riginv.invert" in command:
            continue  # a reader's own folder
        name, *arguments = command.removeprefix("python -m riginv.").split()
        values = [true_rig_choice(argument.strip("'\"")) for argument in arguments if "=" in argument]
        first = (value if "=[" in value else value.partition(",")[0] for value in values)  # of a sweep, the first job
        composed(*first, command=name)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page):
    for link in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        if not link.startswith("http"):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_the_map_names_every_room():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for path in (*(ROOT / "riginv").iterdir(), *(ROOT / "rigs").iterdir()):
        name = path.name.removesuffix(".py")
        if not name.startswith("__"):
            assert re.search(rf"\b{name}\b", text), f"README's map does not name {path.name}"


@pytest.mark.slow
@pytest.mark.parametrize("command", [MAIN, TESTS])
def test_a_newcomer_in_an_empty_directory_gets_through(command, tmp_path):
    subprocess.run(["git", "clone", "--quiet", str(ROOT), "riginv"], cwd=tmp_path, check=True)
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path / "riginv", capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    if command == MAIN:
        assert "Judged by the true rig, face" in done.stdout
        assert list((tmp_path / "riginv/runs/face-inverse").glob("*/metrics.json"))
