"""The columns of a sweep's HPARAMS table in TensorBoard: the choices in which its jobs differ, a few named ones, the errors."""

import math
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.plugins.hparams import api_pb2, metadata, plugin_data_pb2
from tensorboard.summary.writer.event_file_writer import EventFileWriter

from riginv.runs.files import discard

RESULT = "result"  # before the name of every final metric
CHOICES = "hparams.yaml"  # TensorBoard's, in a run's folder
NAMED_COLUMNS = {  # choices that are always shown: key of the config -> heading
    "rig._target_": "rig",
    "model._target_": "model",
    "model.network._target_": "network",
    "sampler._target_": "sampler",
    "model.optimizer.lr": "learning rate",
    "data.batch_size": "batch size",
    "trainer.max_steps": "steps",
    "seed": "seed",
}
EVENTS, ENDING = "events.out.tfevents.*", ".columns"


def write_columns(sweep: Path, folders: Sequence[str], errors: Sequence[str]) -> None:
    """Write the columns as a TensorBoard run of the sweep's folder itself; jobs without choices are left out.

    Args:
        sweep: the sweep's folder.
        folders: the names of its jobs' folders.
        errors: the metrics that are shown.
    """
    values: dict[str, list[Any]] = defaultdict(list)
    for file in (sweep / name / CHOICES for name in folders):
        if file.is_file():
            for key, value in yaml.safe_load(file.read_text(encoding="utf-8")).items():
                values[key].append(value)
    for old in sweep.glob(EVENTS + ENDING):
        discard(old)
    if not values:
        return
    jobs = max(len(chosen) for chosen in values.values())
    columns = [
        _column(key, chosen) for key, chosen in values.items() if len(chosen) < jobs or key in NAMED_COLUMNS or _differ(chosen)
    ]
    choices = sorted(columns, key=lambda column: not column.differs)
    results = [api_pb2.MetricInfo(name=api_pb2.MetricName(tag=f"{RESULT}/{key}")) for key in errors]
    experiment = api_pb2.Experiment(hparam_infos=choices, metric_infos=results, time_created_secs=time.time())
    summary_metadata = metadata.create_summary_metadata(plugin_data_pb2.HParamsPluginData(experiment=experiment))
    value = Summary.Value(tag=metadata.EXPERIMENT_TAG, metadata=summary_metadata, tensor=metadata.NULL_TENSOR)
    writer = EventFileWriter(str(sweep), filename_suffix=ENDING)
    writer.add_event(Event(wall_time=time.time(), summary=Summary(value=[value])))
    writer.close()


def _differ(values: list[Any]) -> bool:
    return len(set(values)) > 1


def _column(key: str, values: list[Any]) -> api_pb2.HParamInfo:
    """A choice of the jobs that have it; it differs where they differ."""
    distinct = sorted(set(values), key=str)
    info = api_pb2.HParamInfo(name=key, display_name=NAMED_COLUMNS.get(key, key), differs=_differ(values))
    if all(isinstance(value, bool) for value in distinct):
        info.type = api_pb2.DATA_TYPE_BOOL
        info.domain_discrete.extend(distinct)
    elif all(isinstance(value, int | float) and math.isfinite(value) for value in distinct):
        info.type = api_pb2.DATA_TYPE_FLOAT64
        info.domain_interval.min_value, info.domain_interval.max_value = min(distinct), max(distinct)
    else:
        info.type = api_pb2.DATA_TYPE_STRING
        info.domain_discrete.extend(map(str, distinct))
    return info
