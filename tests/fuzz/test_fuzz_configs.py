"""Values of configs replaced by anything that YAML can say: the command goes on, or ends in one sentence."""

import copy
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from omegaconf import DictConfig, OmegaConf

from riginv.check import CheckConfig
from riginv.clips.open import open_clip
from riginv.compare import CompareConfig
from riginv.config.messages import CONFIGS, explain
from riginv.config.typed import to_typed
from riginv.contact_sheet import ContactSheetConfig
from riginv.errors import InputError
from riginv.evaluate import EvaluateConfig
from riginv.inspect import InspectConfig, show_clip_file
from riginv.invert import InvertConfig, build_rigs
from riginv.launch.command import split_options
from riginv.methods.base import suited_methods
from riginv.reproduce.preflight import check_capture, choose_true_rig
from riginv.reproduce.rigs import rig_in_space
from riginv.reproduce.sets import CaptureSource
from riginv.reproduce.settings import ReproduceConfig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.runs.run_folder import RunFolder, plain_config, register_folder_resolvers
from riginv.tracking.assembly import build_parts
from riginv.tracking.rigs import build_clip, build_rig, build_true_rig
from riginv.training.assembly import build_module, build_sampler, build_trainer, needs_surrogate
from riginv.training.config import TrainConfig
from tests.support.clips import performance, write_npz
from tests.support.toys import ToyRig

ROOT = Path(__file__).parents[2]
QUICK, MANY = 15, 2500
TOY = ["rig=toy", f"hydra.searchpath=[file://{ROOT / 'tests/conf'}]"]


def before_training(config: DictConfig, folder: Path) -> None:
    """What riginv.train does before its first step."""
    settings = to_typed(config, TrainConfig)
    rig = build_rig(settings.rig, settings.mesh_space, settings.data.store)
    true_rig = build_true_rig(settings.true_rig, rig)
    if needs_surrogate(settings.model, rig):
        return
    build_clip(settings.capture, settings.reading, settings.frames, rig, true_rig)
    module = build_module(settings, RigInMeshSpace(rig, MeshSpace.from_rig(rig)), true_rig)
    build_sampler(settings, module.rig).sample(2, torch.Generator().manual_seed(0))
    build_trainer(settings, RunFolder(folder, plain_config(config), False))


def before_inverting(config: DictConfig, folder: Path) -> None:
    """What riginv.invert does before its first frame."""
    settings = to_typed(config, InvertConfig)
    if settings.bundle:
        raise InputError("a bundle is read by what reads bundles")
    inverse, rig, true_rig = build_rigs(settings)
    clip, _ = open_clip(settings.clip, true_rig, settings.reading, settings.frames)
    build_parts(settings, clip, rig, true_rig, inverse)


def before_evaluating(config: DictConfig, folder: Path) -> None:
    settings = to_typed(config, EvaluateConfig)
    if settings.rig is not None:
        build_true_rig(settings.true_rig, settings.rig.build())


def before_checking(config: DictConfig, folder: Path) -> None:
    to_typed(config, CheckConfig).rig.build()


def before_drawing(config: DictConfig, folder: Path) -> None:
    to_typed(config, ContactSheetConfig).rig.build()


def before_comparing(config: DictConfig, folder: Path) -> None:
    settings = to_typed(config, CompareConfig)
    rig = build_rig(settings.rig, settings.mesh_space)
    build_true_rig(settings.true_rig, rig)
    suited_methods(settings.methods or {}, RigInMeshSpace(rig, MeshSpace.from_rig(rig)))
    build_clip(settings.capture, settings.reading, settings.frames, rig, rig)


def before_inspecting(config: DictConfig, folder: Path) -> None:
    show_clip_file(to_typed(config, InspectConfig), None)


def before_reproducing(config: DictConfig, folder: Path) -> None:
    settings = to_typed(config, ReproduceConfig)
    rig = rig_in_space(settings.rig)
    check_capture(CaptureSource(settings.capture, settings.reading, settings.frames), rig.source)
    if settings.body is not None:
        settings.body.build()
    choose_true_rig(settings.true_rig, rig.source)


COMMANDS: dict[str, tuple[list[str], Callable]] = {
    "train": ([*TOY, "model.network.hidden=[8]", "surrogate.network.hidden=[8]", "trainer.accelerator=cpu"], before_training),
    "invert": ([*TOY, "clip=CLIP", "out=OUT"], before_inverting),
    "evaluate": (TOY, before_evaluating),
    "compare": ([*TOY, "methods=[neutral,direct,levenberg_marquardt,clip]"], before_comparing),
    "reproduce": ([*TOY, "rig@body=toy", "rig@true_rig=same"], before_reproducing),
    "check": (TOY, before_checking),
    "contact_sheet": (TOY, before_drawing),
    "inspect": ([*TOY, "clip=CLIP"], before_inspecting),
}

WORDS = [
    "",
    "null",
    "nan",
    "face",
    "a b",
    "../x",
    "/dev/null",
    "%s",
    "\0",
    "é",
    "x" * 300,
    "os.system",
    "tests.support.toys.ToyRig",
]
NUMBERS = [0, 1, -1, 2, 3, 7, 1.5, -0.0, 1e-30, 1e300, math.nan, math.inf, -math.inf]
SCALARS = st.one_of(
    st.none(), st.booleans(), st.sampled_from(NUMBERS), st.sampled_from(WORDS), st.integers(-5, 40), st.text(max_size=5)
)
KEYS = st.sampled_from(["_target_", "name", "mouth", "jaw*", "file", "0", "", "vertices"])
VALUES = st.recursive(
    SCALARS, lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(KEYS, inner, max_size=3)), max_leaves=5
)


@pytest.fixture(scope="module")
def composed(tmp_path_factory) -> dict[str, Any]:
    """Each command's config as it is composed, small."""
    folder = tmp_path_factory.mktemp("configs")
    rig = ToyRig()
    clip = write_npz(folder / "clip.npz", performance(rig, 3), rig.faces.numpy())
    register_folder_resolvers()
    found = {}
    for name, (overrides, _) in COMMANDS.items():
        GlobalHydra.instance().clear()
        with initialize_config_dir(str(CONFIGS), version_base="1.3"):
            found[name] = compose(
                name, overrides=[one.replace("CLIP", str(clip)).replace("OUT", str(folder / "out")) for one in overrides]
            )
    return found


def places(config: Any, path: tuple = ()) -> list[tuple]:
    """Every key of a config, groups and the elements of lists included."""
    pairs = config.items() if isinstance(config, dict) else enumerate(config) if isinstance(config, list) else ()
    return [place for key, inner in pairs for place in ((*path, key), *places(inner, (*path, key)))]


def replaced(config: dict, path: tuple, value: Any) -> dict:
    config = copy.deepcopy(config)
    inner = config
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return config


def goes_on(name: str, config: dict, folder: Path) -> str | None:
    """None where the command would begin its work, else its one sentence; anything else is raised."""
    try:
        COMMANDS[name][1](OmegaConf.create(config), folder)
    except Exception as error:
        sentence = explain(error, name)
        if sentence is None:
            raise
        assert sentence and "\n" not in sentence and len(sentence) < 2000, sentence
        return sentence
    return None


def explore(name: str, composed: dict[str, Any], cases: int, folder: Path) -> tuple[int, int]:
    whole = OmegaConf.to_container(composed[name], resolve=True)
    assert goes_on(name, whole, folder) is None
    everywhere, counts = places(whole), [0, 0]

    def case(found: Any) -> None:
        path, value = found
        refused = goes_on(name, replaced(whole, path, value), folder) is not None
        counts[refused] += 1

    how = settings(max_examples=cases, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    how(given(st.tuples(st.sampled_from(everywhere), VALUES))(case))()
    return counts[0], counts[1]


@pytest.mark.parametrize("name", COMMANDS)
def test_any_value_anywhere_is_valid_or_refused_in_a_sentence(name, composed, tmp_path):
    _, refused = explore(name, composed, QUICK, tmp_path)
    assert refused >= 3


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_many_more_values_are_valid_or_refused_in_a_sentence(name, composed, tmp_path):
    explore(name, composed, MANY, tmp_path)


@settings(max_examples=200, deadline=None, derandomize=True, database=None)
@given(st.lists(st.text(alphabet="-=abc{}[],$ \"'~+@:/.", max_size=12), max_size=4))
def test_any_arguments_are_sorted_without_losing_one(arguments):
    options, values = split_options(arguments)
    assert sorted(options + values) == sorted(arguments)
