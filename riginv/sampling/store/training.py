"""Training on stored poses."""

import torch
from rich.progress import BarColumn, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.batches import PoseBatch
from riginv.rig.identity import check_same_rig
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.runs.console import Bar
from riginv.sampling.meshes import MeshSampler
from riginv.sampling.store.layout import BASIS, NEUTRAL
from riginv.sampling.store.location import StoreLocation
from riginv.sampling.store.store import PoseStore
from riginv.sampling.store.windows import WindowReader


def finished_store(path: str) -> PoseStore:
    """A complete store to train on.

    Raises:
        InputError: it is missing, damaged or incomplete.
    """
    store = PoseStore.find(StoreLocation(path))
    if store is None:
        raise InputError(f"data.store={path}: there is no store of poses: sample one with python -m riginv.sample out={path}")
    absent = int((store.ledger()[0][:, 0] == 0).sum())
    if absent:
        raise InputError(
            f"data.store={path}: the store is not finished: {absent} of its {store.layout.chunks} chunks are absent; give the "
            f"command that sampled it once more, which goes on where it stopped"
        )
    return store


def rig_of_store(path: str, rig: RigBackend) -> LinearRig:
    """A black-box rig in the basis of a store of its poses.

    Raises:
        InputError: as `finished_store`, or the store is of another rig.
    """
    store = finished_store(path)
    if not store.layout.fitted or store.layout.fitted != len(rig.rest_vertices):
        raise InputError(f"data.store={path} holds poses of rig '{store.facts['rig']['name']}', not of rig '{rig.name}'")
    return store.fitted_rig(rig)


class StoreSampler(MeshSampler):
    """Poses of a store, in an order that depends only on the seed; batches depend only on the step.

    Args:
        path: of the store.
        seed: of the order.

    Raises:
        InputError: as `finished_store`, or the store is of another rig.
    """

    neutral: Tensor
    linear_map: Tensor

    def __init__(self, rig: RigInMeshSpace, path: str, seed: int) -> None:
        super().__init__()
        store = finished_store(path)
        check_same_rig(f"data.store={path}", store.facts["rig"], rig.source)
        basis = store.constant(BASIS).to(rig.linear_map) if store.layout.fitted else None
        linear_map = rig.linear_map if basis is None else basis.flatten(1) @ rig.space.directions.flatten(1).T
        self.register_buffer("neutral", store.constant(NEUTRAL).to(rig.linear_map), persistent=False)
        self.register_buffer("linear_map", linear_map, persistent=False)
        self.reader, self.step = WindowReader(store, seed), 0

    def at_step(self, step: int) -> None:
        self.step = step

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        poses = self.reader.poses(self.step * count, count)
        found = {name: values.to(self.linear_map) for name, values in poses.items()}
        coordinates = (found["coefficients"] - self.neutral) @ self.linear_map
        return PoseBatch(coordinates=coordinates, controls=found["controls"], coefficients=found["coefficients"])


def reading_store(sampler: MeshSampler, rig: RigInMeshSpace, store: str, seed: int) -> MeshSampler:
    """A sampler whose poses of the rig come from a store; other meshes are still drawn during training.

    Args:
        store: its path.
        seed: of the order.

    Raises:
        InputError: the sampler draws no poses of the rig, or as `StoreSampler`.
    """
    stored = StoreSampler(rig, store, seed)
    found = sampler.reading(stored)
    if not any(part is stored for part in found.modules()):
        raise InputError(f"data.store={store} is given, and the sampler draws no poses of the rig: choose sampler=rig_poses")
    return found


class SamplingProgress(Bar):
    """A progress bar over poses; shown only in terminals."""

    def __init__(self) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(24),
            TaskProgressColumn(show_speed=True),
            TextColumn("{task.completed:,.0f} of {task.total:,.0f} poses"),
            TimeRemainingColumn(),
        )
        self.task: TaskID | None = None

    def begin(self, what: str, poses: int) -> None:
        """Start a new phase."""
        if self.task is not None:
            self.bar.remove_task(self.task)
        self.task = self.bar.add_task(what, total=poses)

    def advance(self, poses: int) -> None:
        if self.task is not None:
            self.bar.advance(self.task, poses)
