"""TensorBoard's HPARAMS page: what was chosen beside what came out."""

import math
from typing import Any

from lightning.pytorch.loggers import TensorBoardLogger

from riginv.cli.tables import sets_of

PREFIX = "result"
RESULTS = (
    "random_combinations/mean_vertex_error_mm",
    "rig_poses/mean_vertex_error_mm",
    "capture/mean_vertex_error_mm",
    "simulated_performance/mean_vertex_error_mm",
)


def log_choices(logger: TensorBoardLogger, config: dict[str, Any]) -> None:
    """Log a plain config as flat hyper-parameters; the results' columns are there from the start."""
    logger.log_hyperparams(_flat(config), {f"{PREFIX}/{key}": math.nan for key in RESULTS})


def log_results(logger: TensorBoardLogger, metrics: dict[str, float], step: int) -> None:
    """Fill the results' columns, and log every final metric."""
    known = {f"{PREFIX}/{key}": value for key, value in metrics.items() if key.split("/")[0] in sets_of(metrics)}
    logger.log_metrics(known, step)
    logger.save()


def _flat(config: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in config.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = value if isinstance(value, bool | int | float | str) else str(value)
    return flat
