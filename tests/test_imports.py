"""Architecture rules: import order of packages, file length, no unsafe loading."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
# Lowest layer first: a module may import from its own package and from lower layers.
FLOORS = [
    {"errors"},
    {"runs"},
    {"geometry"},
    {"rig"},
    {"meshes"},
    {"config"},
    {"sampling"},
    {"networks"},
    {"solvers"},
    {"animation"},
    {"inference"},
    {"clips"},
    {"evaluation"},
    {"tracking"},
    {"launch"},
    {"training"},
    {"methods"},
    {"train", "evaluate", "check", "contact_sheet", "compare", "invert", "export_onnx", "sample", "inspect"},
    {"learn_prior", "markers", "missing", "wrap"},
    {"reproduce"},
    {"__main__"},
]
FLOOR = {name: level for level, names in enumerate(FLOORS) for name in names}
SOURCES = [path for folder in ("riginv", "rigs", "hydra_plugins") for path in sorted((ROOT / folder).rglob("*.py"))]


def imported(path: Path) -> set[str]:
    tree = ast.parse(path.read_text())
    names = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    return names | {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}


def room(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


def test_every_room_has_a_floor():
    rooms = {path.relative_to(ROOT / "riginv").parts[0].removesuffix(".py") for path in (ROOT / "riginv").rglob("*.py")}
    assert rooms - {"__init__"} == set(FLOOR)


@pytest.mark.parametrize("path", [path for path in SOURCES if path.is_relative_to(ROOT / "riginv")], ids=lambda path: path.stem)
def test_imports_run_one_way(path):
    here = path.relative_to(ROOT / "riginv").parts[0].removesuffix(".py")
    for module in imported(path):
        assert not module.startswith(("rigs", "tests")), f"{path} imports {module}"
        if module.startswith("riginv.") and room(module) != here and here != "__init__":
            assert FLOOR[room(module)] < FLOOR[here], (
                f"{here} (floor {FLOOR[here]}) imports {module} (floor {FLOOR[room(module)]})"
            )


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_rooms_are_small_and_lightning_has_one_name(path):
    assert len(path.read_text().splitlines()) <= 300
    assert path.name != "utils.py"
    assert not any(module.startswith("pytorch_lightning") for module in imported(path))


SLOW_TO_IMPORT = {"torch", "lightning", "torch._dynamo", "trimesh", "tensorboard", "zarr"}


@pytest.mark.parametrize(
    "arguments, needed",
    [
        (["-m", "riginv.train", "--help"], set()),
        (["-m", "riginv.invert", "rig=body", "--help"], set()),
        (["-m", "rigs.blender.export", "--help"], set()),
        (["-c", "import riginv.invert, riginv.inference.inverse"], {"torch"}),
        (["-c", "import riginv.train"], {"torch", "lightning", "torch._dynamo", "tensorboard"}),
    ],
    ids=lambda value: " ".join(value[1:]) if isinstance(value, list) else "",
)
def test_nothing_slow_is_imported_before_it_is_needed(arguments, needed):
    done = subprocess.run(
        [sys.executable, "-X", "importtime", *arguments], cwd=ROOT, check=True, capture_output=True, encoding="utf-8"
    )
    assert {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()} & SLOW_TO_IMPORT == needed


def test_nothing_is_loaded_that_could_run_code():
    for path in SOURCES:
        text = path.read_text()
        assert not re.search(
            r"\bpickle\b|allow_pickle=True|(?<![.\w])eval\(|(?<![.\w])exec\(|yaml\.load\(|unsafe_load", text
        ), path
        for call in re.findall(r"torch\.load\([^)]*\)", text):
            assert "weights_only=True" in call, path


def test_the_code_keeps_its_own_style():
    subprocess.run(["ruff", "check", "--no-cache", "."], cwd=ROOT, check=True)
    subprocess.run(["ruff", "format", "--no-cache", "--check", "."], cwd=ROOT, check=True)
