"""TensorBoard's HPARAMS page: what was chosen beside what came out. A run tells of itself; a sweep names the columns."""

from typing import Any

from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from torch.utils.tensorboard.summary import hparams

from riginv.cli.sweep_hparams import RESULT
from riginv.cli.tables import sets_of


@rank_zero_only
def log_choices(logger: TensorBoardLogger, config: dict[str, Any]) -> None:
    """Log a plain config as flat hyper-parameters."""
    choices = _flat(config)
    logger.log_hyperparams(choices)  # for hparams.yaml
    _, begun, ended = hparams(choices, {})  # the first would fix the columns by this run alone
    for summary in (begun, ended):
        logger.experiment.file_writer.add_summary(summary)


def log_results(logger: TensorBoardLogger, metrics: dict[str, float], step: int) -> None:
    """Log every final metric: the results' columns."""
    known = {f"{RESULT}/{key}": value for key, value in metrics.items() if key.split("/")[0] in sets_of(metrics)}
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
