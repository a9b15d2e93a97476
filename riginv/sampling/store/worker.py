"""python -m riginv.sampling.store.worker: makes chunks of a store; and the pool of these workers (`riginv.runs.worker_pool`).

`load` gives the store, the rig and the sampler; each `make` has the number of a chunk.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Self

import torch

from riginv.config.building import ClassSpec, build
from riginv.errors import InputError
from riginv.rig.interface import LinearRig, RigBackend
from riginv.runs.worker import serve
from riginv.runs.worker_pool import ATTEMPTS, ProcessPool, Request
from riginv.runs.worker_process import WorkerLostError, WorkerRefusedError, python_worker
from riginv.sampling.meshes import MeshSampler
from riginv.sampling.store.location import StoreLocation
from riginv.sampling.store.making import ChunkMaker, build_sampler
from riginv.sampling.store.store import PoseStore


class ChunkWorkers:
    """Processes that make chunks; they start, and build their rig, at once.

    Args:
        out: location of the store.
        jobs: number of processes.
    """

    def __init__(self, out: str, rig: ClassSpec[RigBackend], sampler: ClassSpec[MeshSampler], jobs: int) -> None:
        command, environment = python_worker("riginv.sampling.store.worker")
        load = {"out": out, "rig": rig.config, "sampler": sampler.config}
        self.pool = ProcessPool(command, load, jobs, timeout_s=None, environment=environment)
        self.pool.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.pool.close()

    def make(self, chunks: Sequence[int]) -> Iterator[int]:
        """Make chunks, and yield their numbers as they are complete.

        Raises:
            InputError: a chunk cannot be made or written.
        """
        with self.pool.job() as job:
            job.submit(*(Request({"command": "make", "chunk": chunk}) for chunk in chunks))
            for request, outcome in job:
                chunk = request.header["chunk"]
                if isinstance(outcome, WorkerLostError):
                    raise InputError(
                        f"chunk {chunk} ended {ATTEMPTS} worker processes in a row; of the last one: {outcome}: it may need "
                        f"more memory than there is; try fewer jobs, or jobs=1 to see it happen"
                    )
                if isinstance(outcome, WorkerRefusedError):
                    raise InputError(str(outcome))
                if isinstance(outcome, BaseException):
                    raise outcome
                yield chunk


class _Worker:
    """The worker's side: builds the rig, then makes chunks."""

    def __init__(self) -> None:
        self.settings: dict[str, Any] = {}
        self.rig: RigBackend | None = None
        self.maker: ChunkMaker | None = None

    def answer(self, header: dict[str, Any]) -> dict[str, Any]:
        if header["command"] == "load":
            torch.set_num_threads(1)
            self.settings, self.rig = header, build(header["rig"], kind=RigBackend)
            return {}
        self.maker = self.maker or self._chunk_maker()  # the store may be begun after the rig was built
        self.maker.make(header["chunk"])
        return {}

    def _chunk_maker(self) -> ChunkMaker:
        location = StoreLocation(self.settings["out"])
        store = PoseStore.find(location, read_only=False)
        if store is None or self.rig is None:
            raise InputError(f"{location}: the store no longer exists")
        rig = self.rig if isinstance(self.rig, LinearRig) else store.fitted_rig(self.rig)
        return ChunkMaker(store, rig, build_sampler(self.settings["sampler"], rig))


if __name__ == "__main__":
    serve(_Worker().answer)
