"""Filling a shard of a store: it is opened or begun, verified, and its missing chunks are made."""

import contextlib
import importlib.metadata
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

from riginv.config.building import ClassSpec
from riginv.config.typed import MeshSpaceConfig
from riginv.config.values import NonNegativeInt, PositiveInt
from riginv.errors import InputError
from riginv.rig.black_box import BlackBoxRig
from riginv.rig.identity import check_same_rig, describe
from riginv.rig.interface import LinearRig, RigBackend
from riginv.runs.threads import allowed_cores, single_threaded
from riginv.sampling.meshes import MeshSampler
from riginv.sampling.store.checking import StoreCondition, examine
from riginv.sampling.store.layout import Layout, default_chunk
from riginv.sampling.store.location import StoreLocation
from riginv.sampling.store.making import ChunkMaker, build_sampler
from riginv.sampling.store.store import PoseStore
from riginv.sampling.store.training import SamplingProgress
from riginv.sampling.store.worker import ChunkWorkers

UNITS = {"controls": "as of each control", "coefficients": "of the rig", "vertices": "mm", "basis": "mm"}
Facts = dict[str, Any]


@dataclass(frozen=True)
class SampleConfig:
    """The config of `riginv.sample`; conf/sample.yaml explains each key."""

    rig: ClassSpec[RigBackend]
    sampler: ClassSpec[MeshSampler]
    samples: PositiveInt
    seed: NonNegativeInt
    shard: str
    dtype: Literal["float32", "float16"]
    vertices: bool
    chunk: PositiveInt | None
    jobs: PositiveInt | None
    recheck: bool
    mesh_space: MeshSpaceConfig
    out: str | None = None
    verify: str | None = None


@dataclass(frozen=True)
class Shard:
    """Every `of`-th chunk of a store, starting at `number`."""

    number: int
    of: int

    @classmethod
    def parse(cls, text: Any) -> "Shard":
        """Parse `i/n`.

        Raises:
            InputError: another format.
        """
        number, _, of = str(text).partition("/")
        if not (number.isdecimal() and of.isdecimal() and int(number) < int(of)):
            raise InputError(f"shard is {text!r}, expected i/n with i from 0 to n - 1, as shard=0/4")
        return cls(int(number), int(of))

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    def chunks(self, layout: Layout) -> range:
        """Indices of its chunks."""
        return range(self.number, layout.chunks, self.of)


@dataclass(frozen=True)
class FillResult:
    """Result of `fill`.

    Attributes:
        condition: the state of the shard's chunks before.
        made: number of poses made.
        absent: number of chunks of the store that other shards have not made yet.
    """

    store: PoseStore
    shard: Shard
    condition: StoreCondition
    made: int
    absent: int


def fill(settings: SampleConfig) -> FillResult:
    """Make the missing chunks of a shard.

    Raises:
        InputError: the store is of another rig or config, another process is sampling the shard, the rig gives NaN or infinite
            values, or a write fails.
    """
    out = str(settings.out)
    location, shard = StoreLocation(out), Shard.parse(settings.shard)
    store = PoseStore.find(location)
    with single_threaded(), contextlib.ExitStack() as stack, SamplingProgress() as progress:
        rig = settings.rig.build()
        jobs = settings.jobs or (len(allowed_cores()) if rig.differentiable else 1)
        workers = None
        if jobs > 1 and (store is None or absent_chunks(store, shard)):  # they build their rig in the meantime
            workers = stack.enter_context(ChunkWorkers(out, settings.rig, settings.sampler, jobs))
        store, rig = open_or_begin(settings, location, shard, store, rig)
        chunks = shard.chunks(store.layout)
        progress.begin("verifying", sum(map(store.layout.count, chunks)))
        condition = examine(store, chunks, settings.recheck, progress.advance)
        made = 0
        if condition.incomplete:
            refusal = f"another process is sampling shard {shard} of it: wait for it, or give another out"
            stack.enter_context(location.exclusive_lock(f"shard-{shard.number}-of-{shard.of}", refusal))
            progress.begin(f"sampling {rig.name}", sum(map(store.layout.count, condition.incomplete)))
            if jobs > 1:
                workers = workers or stack.enter_context(ChunkWorkers(out, settings.rig, settings.sampler, jobs))
                done = workers.make(condition.incomplete)
            else:
                writable = PoseStore.begin(location, store.layout, store.facts, rig)
                sampler = build_sampler(settings.sampler.config, rig)
                done = make_chunks(ChunkMaker(writable, rig, sampler), condition.incomplete)
            for chunk in done:
                made += store.layout.count(chunk)
                progress.advance(store.layout.count(chunk))
        return FillResult(store, shard, condition, made, len(absent_chunks(store)))


def open_or_begin(
    settings: SampleConfig, location: StoreLocation, shard: Shard, store: PoseStore | None, rig: RigBackend
) -> tuple[PoseStore, LinearRig]:
    """The store, created if necessary, and the rig in the basis of the store.

    Raises:
        InputError: the store is of another rig or config, or cannot be created.
    """
    if not isinstance(rig, LinearRig):
        if store is not None and store.layout.fitted == len(rig.rest_vertices):
            rig = store.fitted_rig(rig)
        else:
            rig = BlackBoxRig.sampled(rig, settings.mesh_space.samples, settings.mesh_space.residual_mm)
    layout, facts = plan_store(settings, rig)
    if store is None:
        build_sampler(settings.sampler.config, rig)  # may refuse, before anything is written
        if location.path is None and rig.is_fitted and shard.number:
            raise InputError(f"{location}: start shard=0/{shard.of} first: it fits the basis that all shards share")
        store = PoseStore.begin(location, layout, facts, rig)
        if rig.is_fitted:
            rig = store.fitted_rig(rig.posing_rig())  # of another process, if that was faster
    check_same(store, replace(layout, coefficients=store.layout.coefficients), facts, rig)
    return store, rig


def absent_chunks(store: PoseStore, shard: Shard | None = None) -> list[int]:
    """Chunks that are not in the ledger, of a shard or of all."""
    counts = store.ledger()[0][:, 0]
    return [chunk for chunk in (shard or Shard(0, 1)).chunks(store.layout) if not counts[chunk]]


def make_chunks(maker: ChunkMaker, chunks: list[int]) -> Iterator[int]:
    for chunk in chunks:
        maker.make(chunk)
        yield chunk


def plan_store(settings: SampleConfig, rig: LinearRig) -> tuple[Layout, Facts]:
    """Layout and description of the store of a config."""
    vertices = len(rig.rest_vertices)
    layout = Layout(
        settings.samples,
        1,
        settings.dtype,
        len(rig.controls),
        len(rig.coefficient_names),
        vertices if settings.vertices else 0,
        vertices if rig.is_fitted else 0,
    )
    layout = replace(layout, chunk=settings.chunk or default_chunk(layout, slow=not rig.differentiable))
    facts = {
        "version": importlib.metadata.version("riginv"),
        "seed": settings.seed,
        "sampler": settings.sampler.config,
        "units": UNITS,
        "rig": describe(rig, dict(settings.rig.config)),
    }
    return layout, facts


def check_same(store: PoseStore, layout: Layout, facts: Facts, rig: LinearRig) -> None:
    """Raises InputError where a store was begun with another rig or another config."""
    check_same_rig(str(store), store.facts["rig"], rig)
    before = {**store.layout.as_dict(), "seed": store.facts["seed"], **_flat(store.facts["sampler"], "sampler.")}
    now = {**layout.as_dict(), "seed": facts["seed"], **_flat(facts["sampler"], "sampler.")}
    for key in sorted(before.keys() | now.keys()):
        if before.get(key) != now.get(key):
            raise InputError(
                f"{store} was begun with another config: {key} was {before.get(key)!r}, now {now.get(key)!r}; give the same "
                f"arguments as before, or another out"
            )


def _flat(config: Facts, prefix: str) -> Facts:
    found: Facts = {}
    for key, value in config.items():
        found.update(_flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value})
    return found
