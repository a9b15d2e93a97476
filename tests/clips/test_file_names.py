"""File names that Hydra's grammar reads something else into, typed on real command lines."""

import csv
import json
import subprocess
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from riginv.config.path_values import quoted, with_quoted_paths
from tests.conftest import ROOT
from tests.support.clips import obj_sequence, performance, write_npz
from tests.support.sculpts import POINTS, offset, write_folder
from tests.support.toys import ToyRig

RIG = ToyRig()
TOY = ("rig=toy", f"--config-dir={ROOT / 'tests/conf'}", "method=levenberg_marquardt")
ODD = [
    *(
        "take (1)",
        "[a] b=c",
        "it's",
        'say "hi"',
        "a,b",
        "#1",
        "100%",
        "a;b&c",
        "{x}",
        "$HOME",
        "1e3",
        "2024_05",
        "true",
        "null!",
    ),
    *(
        "日本 語",
        "ärger",
        "Ελληνικά",
        "~x",
        "!",
        "a=b=c",
        "f(x)",
        "[1,2]",
        " leading",
        "a\\b",
        "choice(1)",
        "x'y\"z",
        "nan",
        "0",
    ),
]


def value_of(argument: str) -> object:
    return OverridesParser.create().parse_override(argument).value()


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize(
    "key",
    [
        "clip",
        "scan",
        "markers",
        "actor.neutral",
        "out",
        "capture",
        "bundle",
        "rig.file",
        "rig.folder",
        "+true_rig.folder",
        "hydra.run.dir",
    ],
)
def test_values_of_path_keys_are_text_as_typed(key, name):
    argument = with_quoted_paths([f"{key}={name}.npz"])[0]
    assert argument.startswith(f"{key}=") and value_of(argument) == f"{name}.npz"
    if "$" not in name and name != "[1,2]":
        assert value_of(with_quoted_paths([f"{key}={name}"])[0]) == name


@pytest.mark.parametrize(
    "argument",
    [
        *("seed=1", "clip=null", "clip=a.npz", "clip='take (1).npz'", 'clip="a,b.npz"', "clip=${oc.env:HOME}/a", "clip=", "-m"),
        *(
            "methods=[a,b]",
            "controls.hold={jaw: 0.1}",
            "formats=[csv,glb]",
            "capture=[a.csv,b.csv]",
            "frames.exclude=[1-2]",
            "clip",
        ),
    ],
)
def test_everything_else_is_left_as_it_is(argument):
    assert with_quoted_paths([argument]) == [argument]


def test_sweeps_are_sweeps_unless_a_file_has_that_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert with_quoted_paths(["-m", "clip=a,b"]) == ["-m", "clip=a,b"]
    assert with_quoted_paths(["clip=a,b"]) == ['clip="a,b"']
    (tmp_path / "a,b").write_text("")
    assert with_quoted_paths(["-m", "clip=a,b"]) == ["-m", 'clip="a,b"']
    assert with_quoted_paths(["clip=~/a"]) == [f"clip={Path.home()}/a"]


def test_any_text_in_quotes_is_that_text():
    import random

    draw = random.Random(1)
    for _ in range(2000):
        text = "".join(draw.choice("ab \\\"'()[]{},=#:~%.äß語\n\t&;|*?$") for _ in range(draw.randint(1, 9)))
        if "${" not in text:
            assert value_of(f"clip={quoted(text)}") == text


@pytest.mark.parametrize("name", ["take (1)", "[a] b=c, d", 'it\'s "#1" {x}', "日本 語 ä", "$HOME;~&100%", "1e3", "choice(1)"])
def test_clips_and_results_of_any_name(name, run, tmp_path):
    write_npz(tmp_path / f"{name}.npz", performance(RIG, 3), RIG.faces.numpy())
    outcome = run("invert", *TOY, f"clip={name}.npz", f"out={name} out", "formats=[csv,glb,anim,blender]", "look.sheet=false")
    assert outcome.code == 0, outcome.text
    facts = json.loads((tmp_path / f"{name} out/curves.json").read_text())
    assert f"{name}.npz" in json.dumps(facts, ensure_ascii=False).replace('\\"', '"').replace("\\\\", "\\")
    with (tmp_path / f"{name} out/curves.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 3


@pytest.mark.parametrize(
    "folder, pattern",
    [
        ("my [shots], v=1", ""),
        ("take #2 (final)", "shot.%04d.obj"),
        ("カット 3", "shot.####.obj"),
        ("it's", "shot.*.obj"),
        ("a=b", "shot.<frame>.obj"),
        ("{x}", "shot.$F4.obj"),
    ],
)
def test_sequences_in_folders_of_any_name(folder, pattern, run, tmp_path):
    obj_sequence(tmp_path / folder, performance(RIG, 3), RIG.faces.numpy())
    outcome = run("invert", *TOY, f"clip={folder}/{pattern}", "out=o", "look.page=false", "look.sheet=false")
    assert outcome.code == 0, outcome.text
    with (tmp_path / "o/frames.csv").open() as file:
        assert [row["frame"] for row in csv.DictReader(file)] == ["1001", "1002", "1003"]


@pytest.mark.parametrize("name", ["faces (v2)", "[rig] a=b, c", "Gesicht ä"])
def test_rigs_in_folders_of_any_name(name, run, tmp_path, own_cache):
    write_folder(tmp_path / name, smile=POINTS + offset(1))
    outcome = run("check", "rig=shapes", f"rig.folder={name}", "rig.unit_mm=100")
    assert outcome.code == 0, outcome.text


@pytest.mark.parametrize("folder", ["my takes", "it's $1"])
def test_a_pattern_is_typed_as_the_message_shows_it(folder, run, tmp_path):
    """The message of a refusal, pasted behind `clip=` in a shell."""
    for name in ("a", "b"):
        obj_sequence(tmp_path / folder, performance(RIG, 2), RIG.faces.numpy())
        for number in (1001, 1002):
            (tmp_path / folder / f"shot.{number}.obj").rename(tmp_path / folder / f"{name}.{number:06d}.obj")
    refused = run("invert", *TOY, f"clip={folder}", "out=o")
    assert refused.code == 1 and "2 sequences" in refused.text
    typed = refused.text.strip().partition("give ")[2].partition(" or ")[0]
    word = subprocess.run(["bash", "-c", f"printf %s clip={typed}"], capture_output=True, text=True, check=True).stdout
    done = run("invert", *TOY, word, "out=o", "look.page=false", "look.sheet=false")
    assert done.code == 0, (typed, done.text)


def test_what_other_keys_need_is_shown(run):
    outcome = run("invert", *TOY, "clip=a.glb", "out=o", "reading.mesh=Head (1)")
    assert outcome.code == 1 and "'reading.mesh=\"Head (1)\"'" in outcome.text
