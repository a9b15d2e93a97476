"""A command whose reader goes away, as `| head` does, ends without a traceback; and --help explains what it is asked about."""

import os
import signal
import subprocess
import sys

import pytest

from riginv import contact_sheet, invert, train
from riginv.launch.command import explained_keys
from riginv.launch.terminal import exit_on_broken_pipe
from tests.conftest import COMMANDS, ROOT

TOY = ("rig=toy", f"--config-dir={ROOT / 'tests/conf'}")


def with_closed_output(command: str, *arguments: str, stderr_too: bool = False) -> tuple[int, str]:
    """The exit status of a command whose standard output nobody reads, and what it says on standard error."""
    reading, writing = os.pipe()
    os.close(reading)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-m", f"riginv.{command}", *arguments],
        stdout=writing,
        stderr=writing if stderr_too else subprocess.PIPE,
        text=True,
        env=environment,
    )
    os.close(writing)
    return done.returncode, done.stderr or ""


@pytest.mark.parametrize("arguments", [("train", "--help"), ("check", *TOY), ("compare", "--cfg", "job")], ids=str)
def test_nothing_is_said_of_a_closed_pipe(arguments):
    assert with_closed_output(*arguments) == (1, "")


def test_a_mistake_is_told_where_someone_reads():
    code, said = with_closed_output("check", "rig=fase")
    assert code == 1 and said.startswith("error: rig=fase: there is no such rig") and said.count("\n") == 1
    assert with_closed_output("check", "rig=fase", stderr_too=True) == (1, "")


def test_faults_of_ours_keep_their_traceback():
    with pytest.raises(ZeroDivisionError), exit_on_broken_pipe():
        _ = 1 / 0
    with pytest.raises(BrokenPipeError), exit_on_broken_pipe():  # of a worker: the output is read as before
        raise BrokenPipeError


def test_a_reader_that_stays_gets_everything():
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    shell = f"{sys.executable} -m riginv.train --help | head -3"
    done = subprocess.run(["bash", "-c", shell], capture_output=True, text=True, env=environment)
    assert done.stdout.startswith("riginv trains networks on rigs.") and done.stderr == ""


@pytest.mark.parametrize("command", ["contact_sheet", "check", "inspect", "export_onnx"])
def test_help_explains_every_key(command, run):
    said = run(command, "--help").text
    keys = explained_keys(command).splitlines()
    assert len(keys) >= 2 and all(key in said for key in keys)
    assert all("  # " in key for key in keys), keys  # each with a word of explanation
    assert "blender, blender_if_here, body, dna, face" in said and "verbose: false" in said


@pytest.mark.parametrize("command", sorted({*COMMANDS} - {"reproduce"}))  # which explains its keys in its own words
def test_every_command_has_a_help_text_of_its_own(command, run):
    """That of wrap was a traceback, for the dollar sign of a default."""
    done = run(command, "--help")
    assert done.code == 0 and all(key in done.text for key in explained_keys(command).splitlines()), done.text
    assert "powered by Hydra" not in done.text and "python -m ri" in done.text.partition("Keys:")[0], done.text


def test_help_lists_what_the_command_takes_and_each_key_once(run):
    said = run("wrap", "--help").text
    keys = said.partition("Keys:")[2].partition("Groups (")[0]
    assert keys.count("\n  reading:") == 1 and "${" not in keys, keys
    groups = run("evaluate", "--help", *TOY).text.partition("Groups (")[2].partition("Values (")[0]
    assert ", toy" in groups and "trainer" not in groups, groups  # rigs of --config-dir, and no groups of training


def interrupted(*_args, **_more):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("command", "module", "name"),
    [("invert", invert, "build_rigs"), ("contact_sheet", contact_sheet, "draw"), ("train", train, "build_rig")],
)
def test_ctrl_c_ends_in_one_sentence(command, module, name, run, monkeypatch, tmp_path):
    monkeypatch.setattr(module, name, interrupted)
    arguments = {"invert": ["clip=none.npz", "out=found"], "contact_sheet": ["out=toy.png"], "train": []}[command]
    done = run(command, *(TOY if command != "train" else ()), *arguments)
    assert done.code == 130 and done.text.endswith("stopped: nothing is left half-written\n"), done.text
    assert "Traceback" not in done.text and not list(tmp_path.iterdir())


def test_ctrl_c_before_the_first_step_of_training_says_how_to_go_on(run, monkeypatch):
    monkeypatch.setattr(train, "speed_up", interrupted)  # the folder has begun
    done = run("train")
    assert done.code == 130 and done.text.endswith("stopped: go on with the same command plus resume=true\n"), done.text
    monkeypatch.undo()
    assert run("train", "resume=true").code == 0


def test_ctrl_c_within_the_seconds_of_imports_is_quiet():
    default = lambda: signal.signal(signal.SIGINT, signal.default_int_handler)  # noqa: E731
    process = subprocess.Popen(
        [sys.executable, "-X", "importtime", "-m", "riginv.check", *TOY],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=default,
    )
    assert process.stderr is not None
    while "torch" not in (line := process.stderr.readline()) and line:  # torch is imported after the command has begun
        pass
    process.send_signal(signal.SIGINT)
    said = [line for line in process.stderr.read().splitlines() if not line.startswith("import time")]
    assert process.wait(timeout=60) == 130 and said == ["", "stopped before it began"]
