"""python -m riginv.train: from a config to a judged, bundled model."""

import json

import lightning as L
from omegaconf import DictConfig

from riginv.assemble import build_clip, build_data, build_module, build_rig, build_trainer, build_true_rig, calibrate
from riginv.bundle import write_bundle
from riginv.callbacks.hparams import log_choices, log_results
from riginv.cli.command import command, run_directory
from riginv.cli.run_folder import BUNDLE, METRICS, POSES, RunFolder, find_run_folder, plain_config
from riginv.cli.tables import print_results
from riginv.cli.validation import validate
from riginv.evaluation import judge_model, load_model, write_results
from riginv.mesh_space import MeshSpace, RigInMeshSpace


def train(config: DictConfig) -> None:
    """Train a network on a rig, judge it by the true rig, and leave a bundle, metrics and a table behind."""
    plain = plain_config(config)
    validate(plain)
    folder = find_run_folder(run_directory(), plain, config.resume)
    if folder.finished:
        return show(folder)

    L.seed_everything(plain["seed"], verbose=False)
    rig = build_rig(plain)
    true_rig = build_true_rig(plain, rig)
    module = build_module(plain, RigInMeshSpace(rig, MeshSpace.from_rig(rig)), true_rig)
    clip = build_clip(plain, true_rig) if module.kind == "inverse" else None
    data = build_data(plain, module, true_rig, clip)
    calibrate(plain, module, data.sampler)
    trainer, clock = build_trainer(plain, folder)

    folder.begin()
    log_choices(trainer.logger, plain)
    trainer.fit(module, data, ckpt_path=folder.checkpoint, weights_only=True)

    training = {"steps": trainer.global_step, "seconds": round(clock.seconds, 1), "seed": plain["seed"]}
    bundle = folder.path / BUNDLE
    write_bundle(bundle, module.kind, module.network, module.rig, plain, training)
    judgements = judge_model(load_model(bundle, rig), true_rig, plain["judging"]["test_poses"], clip)
    facts = {"train/steps": training["steps"], "train/seconds": training["seconds"], "seed": plain["seed"]}
    log_results(trainer.logger, write_results(folder.path, judgements, true_rig, facts), trainer.global_step)
    show(folder)


def show(folder: RunFolder) -> None:
    """Show what a finished run reached, and what to do with it."""
    metrics = json.loads((folder.path / METRICS).read_text(encoding="utf-8"))
    steps, seconds = metrics["train/steps"], metrics["train/seconds"]
    print_results(
        metrics,
        f"{steps:,} steps in {seconds / 60:.1f} minutes",
        metrics["true_rig"],
        notes=[
            f"The trained model:  {folder.path / BUNDLE}",
            f"Its worst poses:    {folder.path / POSES}",
            f"Judge it again:     python -m riginv.evaluate bundle='{folder.path / BUNDLE}' capture=TAKE.csv",
            f"Watch or compare:   tensorboard --logdir {folder.path.parent}",
        ],
    )


if __name__ == "__main__":
    command("train")(train)()
