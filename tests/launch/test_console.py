"""The console script `riginv` and the public API of `import riginv`."""

import os
import subprocess
import sys

import pytest

import riginv
from riginv.__main__ import COMMANDS, usage
from riginv.config.messages import CONFIGS
from tests.conftest import ROOT


def riginv_script(*arguments: str, **environment: str) -> subprocess.CompletedProcess:
    code = "import sys; sys.argv[0] = 'riginv'; from riginv.__main__ import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True
    )


def test_every_command_module_is_a_command_with_a_config_and_a_line_of_help():
    modules = {path.stem for path in (ROOT / "riginv").glob("*.py")} - {"__init__", "__main__", "errors"}
    packages = {path.parent.name for path in (ROOT / "riginv").glob("*/__main__.py")}
    assert set(COMMANDS) == modules | packages
    for name, text in COMMANDS.items():
        assert (CONFIGS / f"{name}.yaml").is_file()
        assert any(line.split(maxsplit=1) == [name, text] for line in usage().splitlines())


def test_the_script_runs_a_command_as_python_does():
    script = riginv_script("inspect", "--help")
    module = subprocess.run([sys.executable, "-m", "riginv.inspect", "--help"], cwd=ROOT, capture_output=True, text=True)
    assert script.returncode == 0 and script.stdout == module.stdout and "riginv.inspect PATH" in script.stdout


def test_the_script_finds_classes_of_the_present_folder(tmp_path):
    """As `python -m riginv.COMMAND` does; a module of the folder hides none that is installed."""
    (tmp_path / "mine.py").write_text("from tests.support.toys import ToyRig\n\n\nclass Mine(ToyRig):\n    pass\n")
    (tmp_path / "yaml.py").write_text("raise RuntimeError('not this one')\n")
    (tmp_path / "conf/rig").mkdir(parents=True)
    (tmp_path / "conf/rig/mine.yaml").write_text("_target_: mine.Mine\n")
    code = "import sys; sys.path.remove(''); sys.argv[0] = 'riginv'; from riginv.__main__ import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "check", "--config-dir", "conf", "rig=mine"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and "The rig fulfils the contract" in done.stdout + done.stderr, done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        ([], 0, "riginv COMMAND"),
        (["--version"], 0, f"riginv {riginv.__version__}"),
        (["trian", "rig=face"], 1, "error: riginv trian: there is no such command; did you mean train?"),
        (["zzz"], 1, "known commands: train, evaluate"),
        (["contact-sheet", "--help"], 0, "riginv.contact_sheet"),
        (["inspect", "no/such/file"], 1, "error:"),
    ],
)
def test_arguments_of_the_script(arguments, code, text):
    done = riginv_script(*arguments)
    assert done.returncode == code and text in done.stdout + done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("riginv tr", "train"),
        ("riginv train model=", "model=forward model=holden model=inverse"),
        ("riginv train rig=face trainer.max_s", "trainer.max_steps="),
        ("riginv invert correspond", "correspondence="),
    ],
)
def test_completion_knows_commands_groups_and_keys(line, expected):
    assert riginv_script("-sc", "query=bash", COMP_LINE=line).stdout.strip() == expected


def test_completion_installs_for_the_script():
    assert riginv_script("-sc", "install=bash").stdout.strip().endswith("hydra_bash_completion riginv")


def test_importing_riginv_is_quick_and_offers_the_public_names():
    code = "import sys, riginv; print('torch' in sys.modules); print(all(getattr(riginv, n) for n in riginv.__all__))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        riginv.nothing  # noqa: B018
