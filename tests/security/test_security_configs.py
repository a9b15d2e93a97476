"""Configs of stale: folders for --config-dir, tags, pickles of Hydra and run folders. They choose, and run nothing."""

import shutil

import pytest
import yaml

from riginv.config.building import build
from riginv.config.folders import check_config_folders
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from tests.config.test_bad_input import refused
from tests.support import hostile
from tests.support.hostile import sentence

FOLDERS = {
    "a callback": ("rig/x.yaml", "# @package _global_\nhydra: {callbacks: {x: {_target_: os.system, command: C}}}"),
    "a callback of ours": (
        "rig/x.yaml",
        "# @package _global_\nhydra:\n  callbacks:\n    x: {_target_: riginv.runs.worker_process.WorkerProcess, command: [C]}",
    ),
    "a package": ("rig/x.yaml", "# @package hydra.callbacks.x\n_target_: subprocess.Popen\nargs: [C]"),
    "a launcher": ("hydra/launcher/x.yaml", "_target_: subprocess.Popen\nargs: [C]"),
    "a log handler": ("rig/x.yaml", "# @package _global_\nhydra: {job_logging: {handlers: {x: {(): os.system, command: C}}}}"),
    "a reference": ("rig/x.yaml", "# @package _global_\nhydra: {callbacks: '${rig}'}\nrig: {x: {_target_: os.system}}"),
    "a default": ("rig/x.yaml", "defaults: ['/other@hydra.callbacks: y']\n_target_: rigs.face.FaceRig"),
    "a variable": ("rig/x.yaml", "# @package _global_\nhydra: {job: {env_set: {RIGINV_BLENDER: C}}}"),
    "a search path": ("rig/x.yaml", "# @package _global_\nhydra: {searchpath: ['file:///tmp/x']}"),
    "a program": ("rig/x.yaml", "_target_: rigs.blender.rig.BlenderRig\nfile: a.blend\ninterpreter: C"),
    "a script": ("rig/x.yaml", "_target_: rigs.blender.rig.BlenderRig\nfile: a.blend\nscripts: true"),
}


@pytest.mark.parametrize("what", FOLDERS)
def test_a_folder_of_configs_cannot_have_hydra_run_things(run, tmp_path, mark, what):
    name, text = FOLDERS[what]
    (tmp_path / "theirs" / name).parent.mkdir(parents=True)
    (tmp_path / "theirs" / name).write_text(text.replace("C", f"'touch {mark}'"))
    arguments = [f"--config-dir={tmp_path / 'theirs'}", "rig=x"]
    with pytest.raises(InputError, match=r"x\.yaml"):
        check_config_folders(arguments)
    if what == "a callback of ours":
        refused(run("check", *arguments, small=False), "x.yaml")


@pytest.mark.parametrize("target", ["os.system", "subprocess.Popen", "riginv.runs.worker_process.WorkerProcess"])
def test_a_config_that_a_user_names_builds_rigs_and_nothing_else(run, tmp_path, mark, target):
    (tmp_path / "theirs/rig").mkdir(parents=True)
    program = {"_target_": target, "args": ["touch", str(mark)]}
    (tmp_path / "theirs/rig/x.yaml").write_text(yaml.safe_dump(program))
    refused(run("check", f"--config-dir={tmp_path / 'theirs'}", "rig=x", small=False), target)
    sentence(lambda: build({"_target_": "rigs.shapes.ShapesRig", "folder": program}, kind=RigBackend))


def test_tags_in_a_config_that_a_user_names_make_no_objects(run, tmp_path, mark):
    (tmp_path / "theirs/rig").mkdir(parents=True)
    (tmp_path / "theirs/rig/x.yaml").write_text(f"_target_: {hostile.yaml_run(mark)}")
    refused(run("check", f"--config-dir={tmp_path / 'theirs'}", "rig=x", small=False), "cannot be read as YAML")


def test_a_folder_of_configs_may_still_choose_rigs_numbers_and_launchers(tmp_path):
    files = {
        "rig/mine.yaml": "defaults: [face]\n_target_: my_rig.MyRig\nsize: 3",
        "experiment/mine.yaml": "# @package _global_\ndefaults: ['override /rig: face', 'override /hydra/launcher: basic']",
        "hydra/launcher/farm.yaml": "_target_: hydra_plugins.farm.Launcher\nfolder: ${hydra.sweep.dir}/.farm\nhours: 3",
        "broken.yaml": "a: [",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    check_config_folders(["-cd", str(tmp_path), "rig=mine"])


@pytest.mark.parametrize("option", ["--experimental-rerun", "--exper"])
def test_hydra_unpickles_no_config_of_another_run(run, tmp_path, mark, option):
    (tmp_path / "config.pickle").write_bytes(hostile.bomb(mark))
    with pytest.raises(InputError, match="unpickle"):
        check_config_folders([f"{option}={tmp_path / 'config.pickle'}"])
    if option == "--exper":
        refused(run("check", option, str(tmp_path / "config.pickle"), small=False), "unpickle")


def test_a_run_folder_from_a_stranger_is_compared_and_not_built(run, tmp_path, mark):
    """resume=true reads config.yaml only to see that it is the one that was typed."""
    (tmp_path / "run").mkdir()
    text = yaml.safe_dump({"rig": {"_target_": "os.system", "command": f"touch {mark}"}})
    (tmp_path / "run/config.yaml").write_text(hostile.signed(text))
    refused(run("train", "resume=true"), "cannot be resumed with another config")
    shutil.rmtree(tmp_path / "run")
