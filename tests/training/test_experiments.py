"""Every experiment composes to the paper's numbers, and runs a few steps."""

from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from riginv.config.messages import CONFIGS
from riginv.config.typed import to_typed
from riginv.runs.run_folder import register_folder_resolvers
from riginv.training.config import TrainConfig

EXPERIMENTS = sorted(
    path.relative_to(CONFIGS / "experiment").with_suffix("").as_posix() for path in (CONFIGS / "experiment").rglob("*.yaml")
)
FEW_STEPS = [
    "trainer.max_steps=4",
    "data.steps_per_epoch=2",
    "data.batch_size=4",
    "evaluation.test_poses=6",
    "evaluation.validation_poses=2",
    "pictures.every_n_validations=null",
    "pictures.final=false",
    "trainer.log_every_n_steps=1",
]


def composed(*arguments: str, command: str = "train") -> dict:
    register_folder_resolvers()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        return OmegaConf.to_container(compose(command, list(arguments)), resolve=True)


def test_there_is_one_for_everything_that_the_paper_trains():
    assert EXPERIMENTS == [
        "paper/forward",
        "paper/holden",
        "paper/inverse",
        "paper/inverse_through_surrogate",
        "rigs_and_models",
    ]


@pytest.mark.parametrize("name", ["paper/inverse", "paper/holden", "paper/inverse_through_surrogate"])
def test_an_inverse_of_the_paper_has_the_papers_numbers(name):
    config = composed(f"experiment={name}", *(["rig.bundle=x"] if "through" in name else []))
    to_typed(config, TrainConfig)
    network = config["model"]["network"]
    assert network["hidden"] == [2048, 1024, 512, 256] and network["activation"] == "leaky_relu"
    assert network["control_map"] == "range_tanh"
    assert config["model"]["optimizer"]["_target_"] == "torch.optim.Adam" and config["model"]["optimizer"]["lr"] == 1e-4
    assert (config["model"]["schedule"]["factor"], config["model"]["schedule"]["patience"]) == (0.5, 20)
    assert config["stop_below_lr"] == 1e-6 and config["trainer"]["max_steps"] is None
    assert (config["data"]["batch_size"], config["data"]["steps_per_epoch"]) == (64, 10_000)
    assert config["evaluation"]["test_poses"] == 10_000
    sampler = config["sampler"]["_target_"].rpartition(".")[2]
    assert sampler == ("RigPoses" if "holden" in name else "RandomCombinations")
    if "holden" not in name:
        assert config["model"]["loss"]["_target_"].endswith("SquaredVertexLoss")


def test_the_surrogate_of_the_paper_has_the_papers_numbers():
    config = composed("experiment=paper/forward")
    to_typed(config, TrainConfig)
    assert config["model"]["network"]["hidden"] == [1024, 1024]
    assert config["model"]["loss"]["_target_"].endswith("SquaredVertexLoss")
    assert config["data"]["stored_poses"] == 90_000 and config["evaluation"]["test_poses"] == 10_000
    assert config["sampler"]["controls"]["max_active"] is None


@pytest.mark.slow
def test_every_experiment_runs_a_few_steps_on_the_face(run):
    forward = run("train", "experiment=paper/forward", "data.stored_poses=50", *FEW_STEPS, small=False, folder="forward")
    assert forward.code == 0, forward.text
    for name in EXPERIMENTS[1:]:
        through = [f"rig.bundle={forward.folder}"] if "through" in name else []
        made = run("train", f"experiment={name}", *through, *FEW_STEPS, small=False, folder=Path(name).name)
        assert made.code == 0, made.text
        assert made.metrics["true_rig"] == "face"  # whatever was trained through
    again = run("evaluate", f"bundle={made.folder}", "poses=6", small=False, folder="again")
    assert again.code == 0, again.text
    key = "rig_poses/mean_vertex_error_mm"
    assert again.metrics[key] == pytest.approx(made.metrics[key], rel=1e-4)
    agreement = run(
        "evaluate", "rig=surrogate", f"rig.bundle={forward.folder}", "true_rig=face", "poses=6", small=False, folder="rigs"
    )
    assert agreement.metrics["rig_agreement/mean_vertex_error_mm"] == pytest.approx(forward.metrics[key], rel=1e-4)


def test_the_plateau_schedule_ends_the_papers_training(run):
    made = run(
        "train",
        "experiment=paper/inverse",
        "rig=toy",
        "model.schedule.patience=0",
        "model.schedule.threshold=10",
        "trainer.max_steps=null",
        "model.network.hidden=[8]",
    )
    assert made.code == 0, made.text
    assert made.metrics["train/steps"] == 7 * 6  # halved after each of 7 epochs, 1e-4 falls below 1e-6
