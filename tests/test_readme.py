"""What the README and the docs say can be typed works."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest

from riginv.__main__ import COMMANDS
from riginv.launch.command import true_rig_choice
from tests.conftest import ROOT
from tests.training.test_experiments import composed

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SETUP = "python3 -m venv .venv && . .venv/bin/activate"
MAIN = f"{SETUP} && pip install --no-compile . && python -m riginv.train rig=face model=inverse"
TESTS = f"{SETUP} && pip install -e '.[test]' && python -m pytest"


def commands(page: Path) -> list[str]:
    """The command lines of riginv in a page, `python -m riginv.NAME ...` and `riginv NAME ...`, both in the first form."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    lines = re.findall(
        rf"(?:python -m riginv\.|(?:^|(?<=`)|(?<=&& ))riginv )((?:{'|'.join(COMMANDS)})\b[^\n`|#&]*)", text, re.MULTILINE
    )
    return sorted({f"python -m riginv.{line.strip()}" for line in lines})


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
        name, *arguments = shlex.split(command.removeprefix("python -m riginv."))
        values = [true_rig_choice(argument) for argument in arguments if "=" in argument]
        first = (value if "=[" in value else value.partition(",")[0] for value in values)  # of a sweep, the first job
        composed(*first, command=name)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page):
    for link in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        if not link.startswith("http"):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_the_map_of_the_architecture_names_every_package():
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    for path in (*(ROOT / "riginv").iterdir(), *(ROOT / "rigs").iterdir()):
        name = path.name.removesuffix(".py")
        if not name.startswith("__") and name != "py.typed":
            assert re.search(rf"`{name}`", text), f"docs/architecture.md does not name {path.name}"


def test_every_page_of_the_site_is_in_its_navigation():
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in PAGES[1:]}
    assert pages == set(re.findall(r"\S+\.md$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))


def test_docs_name_files_that_are_there():
    for page in PAGES:
        for path in re.findall(r"`((?:riginv|rigs|conf|tests|benchmarks|examples|hydra_plugins)/[\w/.]+)`", page.read_text()):
            assert (ROOT / path).exists(), f"{page.name}: {path}"
        for module in re.findall(r"^::: ([\w.]+)$", page.read_text(), re.MULTILINE):
            assert (ROOT / module.replace(".", "/")).with_suffix(".py").is_file(), f"{page.name}: {module}"


@pytest.mark.slow
@pytest.mark.parametrize("command", [MAIN, TESTS])
def test_a_newcomer_in_an_empty_directory_gets_through(command, tmp_path):
    subprocess.run(["git", "clone", "--quiet", str(ROOT), "riginv"], cwd=tmp_path, check=True)
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path / "riginv", capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    if command == MAIN:
        assert "Evaluated on the true rig, face" in done.stdout
        assert list((tmp_path / "riginv/runs/face-inverse").glob("*/metrics.json"))
