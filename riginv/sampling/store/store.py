"""Stores of poses, written and read chunk by chunk."""

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
import zarr
from zarr.storage import LocalStore

from riginv.config.aliases import upgraded
from riginv.errors import InputError
from riginv.rig.black_box import BlackBoxRig
from riginv.rig.interface import LinearRig, RigBackend
from riginv.runs.checksums import crc32c, text_sha256
from riginv.runs.files import discard
from riginv.sampling.store.layout import BASIS, FORMAT, LEDGER, NEUTRAL, Layout
from riginv.sampling.store.location import StoreLocation

ATTRIBUTE, SUM = "riginv", "riginv_sha256"
AGAIN = "give the sampling command again, which makes it anew"
UNREADABLE = (ValueError, KeyError, TypeError, RuntimeError, EOFError)  # raised by zarr for damaged files


class DamagedError(InputError):
    """Data of a store differs from what was written."""


class PoseStore:
    """An open store.

    Attributes:
        location: of the store.
        facts: description: `layout`, `rig`, `seed`, `sampler`, `units`, riginv's `version` and `format`.
        layout: sizes of the arrays.
    """

    def __init__(self, location: StoreLocation, group: zarr.Group, facts: dict[str, Any]) -> None:
        self.location, self.group, self.facts = location, group, facts
        self.layout = Layout(**facts["layout"])
        self.arrays = {name: _planned(location, group, name, plan) for name, plan in self.layout.plans().items()}

    def __str__(self) -> str:
        return str(self.location)

    @classmethod
    def find(cls, location: StoreLocation, read_only: bool = True) -> "PoseStore | None":
        """The store at a location, or None.

        Raises:
            InputError: something else is there, or a store that is damaged or of another format.
        """
        if location.holds_other_things():
            raise InputError(f"{location}: there is something that is no store of riginv: choose another folder")
        try:
            group = zarr.open_group(location.open(read_only), mode="r" if read_only else "r+")
        except FileNotFoundError:
            return None
        except UNREADABLE as error:
            raise DamagedError(f"{location}/zarr.json cannot be read ({_first_line(error)}): sample another store") from None
        attributes = dict(group.attrs)
        facts = attributes.get(ATTRIBUTE)
        if not isinstance(facts, dict):
            if not list(group.attrs):
                return None  # begun at a remote location, and stopped before it was described
            raise InputError(f"{location}: this is no store of riginv: choose another folder")
        if facts.get("format") != FORMAT:
            other = facts.get("format")
            raise InputError(
                f"{location}: a store of format {other!r}, and this riginv has format {FORMAT}: sample another store"
            )
        if attributes.get(SUM) != text_sha256(json.dumps(facts, sort_keys=True)):
            raise DamagedError(f"{location}/zarr.json: altered since it was written (SHA-256 differs): sample another store")
        return cls(location, group, upgraded(facts))

    @classmethod
    def begin(cls, location: StoreLocation, layout: Layout, facts: dict[str, Any], rig: LinearRig) -> "PoseStore":
        """Create a store without chunks, or open the one that another process has created since.

        Raises:
            InputError: it cannot be written.
        """
        facts = {"format": FORMAT, **facts, "layout": layout.as_dict()}
        constants = {NEUTRAL: rig.neutral_coefficients()[0]} | ({BASIS: rig.basis} if layout.fitted else {})
        values = {name: value.detach().cpu().float().numpy() for name, value in constants.items()}
        with location.writing(), location.exclusive_lock("begin"):
            store = cls.find(location, read_only=False)
            if store is None and location.path is not None:
                for remains in location.path.parent.glob(f".{location.path.name}.*.part"):
                    discard(remains)
                partial = location.path.with_name(f".{location.path.name}.{os.getpid()}.part")
                try:
                    _make(LocalStore(partial), layout, facts, values)
                    partial.replace(location.path)
                finally:
                    discard(partial)
            elif store is None:
                _make(location.open(read_only=False), layout, facts, values)
            store = store or cls.find(location, read_only=False)
        if store is None:
            raise InputError(f"{location}: the store no longer exists")
        return store

    def read(self, name: str, chunk: int) -> np.ndarray:
        """Rows of an array for a chunk, as stored.

        Raises:
            DamagedError: it cannot be read.
        """
        try:
            return np.asarray(self.arrays[name][self.layout.slice_of(name, chunk)])
        except UNREADABLE as error:
            raise DamagedError(f"{self}: chunk {chunk} of '{name}' is damaged ({_first_line(error)}): {AGAIN}") from None

    def read_checked(self, name: str, chunk: int, row: np.ndarray) -> np.ndarray:
        """As `read`, verified by a row of the ledger.

        Raises:
            DamagedError: it cannot be read, or differs from what was written.
        """
        values = self.read(name, chunk)
        if crc32c(values) != row[1 + self.layout.checked.index(name)]:
            what = "missing" if not np.isfinite(values.flat[0]) else "not what was written"
            raise DamagedError(f"{self}: chunk {chunk} of '{name}' is {what}: {AGAIN}")
        return values

    def constant(self, name: str) -> torch.Tensor:
        """An array that is independent of chunks.

        Raises:
            DamagedError: it cannot be read, or is missing.
        """
        try:
            values = np.asarray(self.arrays[name][:])
        except UNREADABLE as error:
            raise DamagedError(f"{self}: '{name}' is damaged ({_first_line(error)}): sample another store") from None
        if not np.isfinite(values).all():
            raise DamagedError(f"{self}: '{name}' is missing: sample another store")
        return torch.from_numpy(values)

    def per_chunk(self, name: str) -> np.ndarray:
        """An array with one row for each chunk, of a complete store.

        Raises:
            DamagedError: a part cannot be read, or is missing.
        """
        try:
            values = np.asarray(self.arrays[name][:])
        except UNREADABLE as error:
            raise DamagedError(f"{self}: '{name}' is damaged ({_first_line(error)}): {AGAIN}, for all shards") from None
        if not np.isfinite(values).all():
            raise DamagedError(f"{self}: a part of '{name}' is missing: {AGAIN}, for all shards")
        return values

    def ledger(self) -> tuple[np.ndarray, list[int]]:
        """The ledger `(chunk, 1 + array)`, 0 for absent chunks, and the chunks whose row is damaged."""
        try:
            return self._valid(np.asarray(self.arrays[LEDGER][:])), []
        except UNREADABLE:
            pass
        rows, damaged = np.zeros(self.arrays[LEDGER].shape, np.uint32), []
        for chunk in range(self.layout.chunks):
            try:
                rows[chunk] = self.read(LEDGER, chunk)[0]
            except DamagedError:
                damaged.append(chunk)
        return self._valid(rows), damaged

    def _valid(self, rows: np.ndarray) -> np.ndarray:
        """The rows with the right number of poses, others set to 0."""
        counts = np.array([self.layout.count(chunk) for chunk in range(self.layout.chunks)])
        return np.where((rows[:, 0] == counts)[:, None], rows, 0)

    def write(self, chunk: int, values: Mapping[str, np.ndarray]) -> None:
        """Write a chunk, with its row of the ledger last.

        Args:
            values: for each of `layout.checked`.

        Raises:
            InputError: it cannot be written.
        """
        sums = [crc32c(values[name]) for name in self.layout.checked]
        with self.location.writing():
            self.arrays[LEDGER][chunk] = 0  # absent while it is written
            for name in self.layout.checked:
                self.arrays[name][self.layout.slice_of(name, chunk)] = values[name]
            self.arrays[LEDGER][chunk] = np.array([self.layout.count(chunk), *sums], np.uint32)

    def remove_partial_files(self) -> None:
        """Remove partial files of killed processes; only for complete stores, since others may be writing."""
        if self.location.path is not None:
            with self.location.writing():
                for partial in self.location.path.rglob("*.partial"):
                    discard(partial)

    def note(self, **attributes: Any) -> None:
        """Store attributes beside the description."""
        with self.location.writing():
            self.group = zarr.open_group(self.location.open(read_only=False), mode="r+").update_attributes(attributes)

    def fitted_rig(self, rig: RigBackend) -> BlackBoxRig:
        """A black-box rig in the basis of the store."""
        return BlackBoxRig(rig, self.constant(BASIS).to(rig.rest_vertices))


def _make(store: Any, layout: Layout, facts: dict[str, Any], constants: dict[str, np.ndarray]) -> None:
    group = zarr.open_group(store, mode="w", zarr_format=3)
    for name, plan in layout.plans().items():
        array = plan.create_in(group, name)
        if name in constants:
            array[:] = constants[name]
    group.update_attributes({ATTRIBUTE: facts, SUM: text_sha256(json.dumps(facts, sort_keys=True))})  # last: now it is begun


def _planned(location: StoreLocation, group: zarr.Group, name: str, plan: Any) -> zarr.Array:
    try:
        array = group[name]
    except (*UNREADABLE, FileNotFoundError) as error:
        raise DamagedError(
            f"{location}/{name}/zarr.json: missing or damaged ({_first_line(error)}): sample another store"
        ) from None
    if not isinstance(array, zarr.Array) or not plan.describes(array):
        raise DamagedError(f"{location}/{name}/zarr.json: altered since it was written: sample another store")
    return array


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
