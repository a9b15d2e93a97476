"""python -m riginv.sample: millions of poses of a rig in a store, which several processes may fill."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "sample")  # before the imports that take seconds

import sys
import time
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from riginv.config.typed import to_typed
from riginv.errors import InputError, listed
from riginv.sampling.store.checking import examine
from riginv.sampling.store.filling import FillResult, SampleConfig, fill
from riginv.sampling.store.location import StoreLocation
from riginv.sampling.store.store import PoseStore
from riginv.sampling.store.summary import findings, finish, show
from riginv.sampling.store.training import SamplingProgress

NAMED = 8  # damaged chunks in the table, at most


def sample(config: DictConfig) -> None:
    """Make the missing chunks of a shard of `config.out`, or verify a store."""
    settings = to_typed(config, SampleConfig)
    if settings.verify:
        verify(settings.verify)
        return
    if not settings.out:
        raise InputError("out must be given: add out=NAME.zarr")
    began = time.perf_counter()
    try:
        filled = fill(settings)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"the same command goes on with {settings.out} where this one was") from None
    if not filled.absent:
        finish(filled.store)
    show(filled.store, summary_rows(filled, time.perf_counter() - began))


def summary_rows(filled: FillResult, seconds: float) -> dict[str, str]:
    """What a run made and repaired, as table rows."""
    rows = {}
    if filled.condition.damaged:
        rows["repaired"] = "; ".join(list(filled.condition.damaged.values())[:NAMED])
    if filled.made:
        rows["made now"] = f"{filled.made:,} poses in {seconds:.0f} s: {filled.made / seconds:,.0f} a second"
    if filled.absent:
        rows["state"] = f"shard {filled.shard} is complete; {filled.absent} chunks of other shards are absent"
        return rows
    state = "finished" if filled.made else "finished: there was nothing to do"
    return {**rows, **findings(filled.store), "state": f"{state} (train on it with data.store={filled.store})"}


def verify(path: str) -> None:
    """Read every chunk of a store, name those that are absent or damaged, and exit with 1 where there are any."""
    store = PoseStore.find(StoreLocation(path))
    if store is None:
        raise InputError(f"verify={path}: there is no store of poses")
    with SamplingProgress() as progress:
        progress.begin("verifying", store.layout.samples)
        condition = examine(store, advance=progress.advance)
    rows: dict[str, str] = {}
    if condition.absent:
        rows["absent"] = f"{len(condition.absent)} chunks: {listed(condition.absent)}"
    for number, fault in enumerate(list(condition.damaged.values())[:NAMED]):
        rows[f"damaged ({number + 1} of {len(condition.damaged)})"] = fault
    if condition.complete:
        show(store, {**findings(store), "state": "finished, and every chunk matches its checksum"})
        return
    show(store, {**rows, "state": "run the sampling command again: it makes these chunks"})
    sys.exit(1)


class ShardsEnd(Callback):
    """After a multirun: prints the state of the store that its jobs have filled."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        store = PoseStore.find(StoreLocation(str(config.out))) if config.out else None
        if store is not None:
            absent = int((store.ledger()[0][:, 0] == 0).sum())
            state = (
                f"{absent} of {store.layout.chunks} chunks are absent: give the same command again" if absent else "finished"
            )
            show(store, {"state": state})


if __name__ == "__main__":
    command("sample")(sample)()
