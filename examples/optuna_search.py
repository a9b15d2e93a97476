"""A search for good settings by Optuna, on riginv's public parts: every trial is a run, in a folder of its own.

    pip install 'riginv[search]'
    python examples/optuna_search.py rig=face trainer.max_steps=500 --trials 20 --out runs/search

The same command again goes on with the search. Change SPACE to what you want to search, and GOAL to what shall be small.
"""

import argparse
import json
from pathlib import Path

import optuna
from hydra import compose, initialize_config_dir

from riginv.config.messages import CONFIGS
from riginv.config.typed import to_typed
from riginv.errors import InputError, NonFiniteLossError
from riginv.launch.terminal import filter_warnings
from riginv.runs.run_folder import METRICS, find_run_folder, plain_config
from riginv.tracking.rigs import build_rig, build_true_rig
from riginv.train import fit
from riginv.training.config import TrainConfig

GOAL = "rig_poses/mean_vertex_error_mm"
SPACE = {
    "model.optimizer.lr": lambda trial, key: trial.suggest_float(key, 3e-4, 1e-2, log=True),
    "data.batch_size": lambda trial, key: trial.suggest_categorical(key, [32, 64, 128]),
    "model/schedule": lambda trial, key: trial.suggest_categorical(key, ["cosine", "plateau"]),
}


def search(overrides: list[str], trials: int, out: Path) -> optuna.Study:
    """Run so many more trials of riginv.train with these arguments; the study, whose file is kept in `out`."""
    settings = to_typed(configured(overrides), TrainConfig)
    rig = build_rig(settings.rig, settings.mesh_space, settings.data.store)
    true_rig = build_true_rig(settings.true_rig, rig)

    def error_mm(trial: optuna.Trial) -> float:
        chosen = [f"{key}={suggest(trial, key)}" for key, suggest in SPACE.items()]
        config = configured([*overrides, *chosen])
        folder = find_run_folder(out / f"{trial.number:03d}", config, resume=False)
        try:
            fit(to_typed(config, TrainConfig), folder, rig, true_rig)
        except NonFiniteLossError as error:
            raise optuna.TrialPruned(str(error)) from None
        return json.loads((folder.path / METRICS).read_text(encoding="utf-8"))[GOAL]

    out.mkdir(parents=True, exist_ok=True)
    study = optuna.create_study(study_name="riginv", storage=f"sqlite:///{out}/study.db", load_if_exists=True)
    study.optimize(error_mm, n_trials=trials)
    return study


def configured(overrides: list[str]) -> dict:
    """The plain config of `python -m riginv.train OVERRIDES`."""
    return plain_config(compose("train", overrides))


def main() -> None:
    parser = argparse.ArgumentParser(description="Search for good settings of riginv.train.")
    parser.add_argument("overrides", nargs="*", help="arguments of riginv.train, such as rig=face trainer.max_steps=500")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("runs/search"))
    given = parser.parse_args()
    filter_warnings()
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        try:
            study = search(given.overrides, given.trials, given.out)
        except InputError as error:
            raise SystemExit(f"error: {error}") from None
    best = study.best_trial
    print(f"The best of {len(study.trials)} trials: {best.value:.4g} mm, {given.out / f'{best.number:03d}'}")
    print(" ".join(f"{key}={value}" for key, value in best.params.items()))


if __name__ == "__main__":
    main()
