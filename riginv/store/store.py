"""A store of poses: begun once, filled chunk by chunk, read by chunks."""

import hashlib
import json
import os
from collections.abc import Mapping
from typing import Any

import google_crc32c
import numpy as np
import torch
import zarr
from zarr.storage import LocalStore

from riginv.config.aliases import upgraded
from riginv.errors import InputError
from riginv.rig.black_box import BlackBoxRig
from riginv.rig.interface import LinearRig, RigBackend
from riginv.runs.files import discard
from riginv.store.layout import BASIS, FORMAT, LEDGER, NEUTRAL, Layout
from riginv.store.place import Place

ATTRIBUTE, SUM = "riginv", "riginv_sha256"
AGAIN = "give the sampling command again, which makes it anew"
UNREADABLE = (ValueError, KeyError, TypeError, RuntimeError, EOFError)  # of what zarr says of damaged files


class DamagedError(InputError):
    """Something in a store is not what was written."""


class PoseStore:
    """An open store.

    Attributes:
        place: where it lies.
        facts: what was written when it was begun: `layout`, `rig`, `seed`, `sampler`, `units`, riginv's `version` and `format`.
        layout: its sizes.
    """

    def __init__(self, place: Place, group: zarr.Group, facts: dict[str, Any]) -> None:
        self.place, self.group, self.facts = place, group, facts
        self.layout = Layout(**facts["layout"])
        self.arrays = {name: _planned(place, group, name, plan) for name, plan in self.layout.plans().items()}

    def __str__(self) -> str:
        return str(self.place)

    @classmethod
    def find(cls, place: Place, read_only: bool = True) -> "PoseStore | None":
        """The store that lies at a place, or None.

        Raises:
            InputError: what lies there is no store of riginv, of another format, or damaged.
        """
        if place.holds_other_things():
            raise InputError(f"{place}: there is something that is no store of riginv: choose another folder")
        try:
            group = zarr.open_group(place.open(read_only), mode="r" if read_only else "r+")
        except FileNotFoundError:
            return None
        except UNREADABLE as error:
            raise DamagedError(f"{place}/zarr.json cannot be read ({_first_line(error)}): sample another store") from None
        attributes = dict(group.attrs)
        facts = attributes.get(ATTRIBUTE)
        if not isinstance(facts, dict):
            if not list(group.attrs):
                return None  # begun at a remote place, and stopped before it was described
            raise InputError(f"{place}: this is no store of riginv: choose another folder")
        if facts.get("format") != FORMAT:
            raise InputError(
                f"{place}: a store of format {facts.get('format')!r}, and this riginv has format {FORMAT}: sample another store"
            )
        if attributes.get(SUM) != description_sum(facts):
            raise DamagedError(f"{place}/zarr.json: altered since it was written (SHA-256 differs): sample another store")
        return cls(place, group, upgraded(facts))

    @classmethod
    def begin(cls, place: Place, layout: Layout, facts: dict[str, Any], rig: LinearRig) -> "PoseStore":
        """Make a store with no chunks in it; where another process was quicker, open that one's.

        Raises:
            InputError: it cannot be written.
        """
        facts = {"format": FORMAT, **facts, "layout": layout.as_dict()}
        constants = {NEUTRAL: rig.neutral_coefficients()[0]} | ({BASIS: rig.basis} if layout.fitted else {})
        values = {name: value.detach().cpu().float().numpy() for name, value in constants.items()}
        with place.writing(), place.exclusive_lock("begin"):
            found = cls.find(place, read_only=False)
            if found is None and place.path is not None:
                for left in place.path.parent.glob(f".{place.path.name}.*.part"):
                    discard(left)
                beside = place.path.with_name(f".{place.path.name}.{os.getpid()}.part")
                try:
                    _make(LocalStore(beside), layout, facts, values)
                    beside.replace(place.path)
                finally:
                    discard(beside)
            elif found is None:
                _make(place.open(read_only=False), layout, facts, values)
        return found or cls.find(place, read_only=False)

    def read(self, name: str, chunk: int) -> np.ndarray:
        """What an array holds of a chunk, as it is stored.

        Raises:
            DamagedError: it cannot be read.
        """
        try:
            return self.arrays[name][self.layout.place(name, chunk)]
        except UNREADABLE as error:
            raise DamagedError(f"{self}: chunk {chunk} of '{name}' is damaged ({_first_line(error)}): {AGAIN}") from None

    def read_checked(self, name: str, chunk: int, row: np.ndarray) -> np.ndarray:
        """As `read`, compared with a row of the ledger.

        Raises:
            DamagedError: it cannot be read, or is not what was written.
        """
        values = self.read(name, chunk)
        if checksum(values) != row[1 + self.layout.checked.index(name)]:
            what = "missing" if not np.isfinite(values.flat[0]) else "not what was written"
            raise DamagedError(f"{self}: chunk {chunk} of '{name}' is {what}: {AGAIN}")
        return values

    def constant(self, name: str) -> torch.Tensor:
        """An array that belongs to no chunk.

        Raises:
            DamagedError: it cannot be read, or is missing.
        """
        try:
            values = self.arrays[name][:]
        except UNREADABLE as error:
            raise DamagedError(f"{self}: '{name}' is damaged ({_first_line(error)}): sample another store") from None
        if not np.isfinite(values).all():
            raise DamagedError(f"{self}: '{name}' is missing: sample another store")
        return torch.from_numpy(values)

    def of_all_chunks(self, name: str) -> np.ndarray:
        """A whole array that has one row for each chunk, of a store whose chunks are all there.

        Raises:
            DamagedError: part of it cannot be read, or is missing.
        """
        try:
            values = self.arrays[name][:]
        except UNREADABLE as error:
            raise DamagedError(f"{self}: '{name}' is damaged ({_first_line(error)}): {AGAIN}, for all shards") from None
        if not np.isfinite(values).all():
            raise DamagedError(f"{self}: a part of '{name}' is missing: {AGAIN}, for all shards")
        return values

    def ledger(self) -> tuple[np.ndarray, list[int]]:
        """The ledger `(chunk, 1 + array)`, with 0 for chunks that are absent, and the chunks whose row is damaged."""
        try:
            return self._sized(self.arrays[LEDGER][:]), []
        except UNREADABLE:
            pass
        rows, damaged = np.zeros(self.arrays[LEDGER].shape, np.uint32), []
        for chunk in range(self.layout.chunks):
            try:
                rows[chunk] = self.read(LEDGER, chunk)[0]
            except DamagedError:
                damaged.append(chunk)
        return self._sized(rows), damaged

    def _sized(self, rows: np.ndarray) -> np.ndarray:
        counts = np.array([self.layout.count(chunk) for chunk in range(self.layout.chunks)])
        return np.where((rows[:, 0] == counts)[:, None], rows, 0)

    def write(self, chunk: int, values: Mapping[str, np.ndarray]) -> None:
        """Write a chunk, its row of the ledger last.

        Args:
            values: for each of `layout.checked`.

        Raises:
            InputError: it cannot be written.
        """
        sums = [checksum(values[name]) for name in self.layout.checked]
        with self.place.writing():
            self.arrays[LEDGER][chunk] = 0  # while it is written it is absent
            for name in self.layout.checked:
                self.arrays[name][self.layout.place(name, chunk)] = values[name]
            self.arrays[LEDGER][chunk] = np.array([self.layout.count(chunk), *sums], np.uint32)

    def clear_leftovers(self) -> None:
        """Remove what killed processes left half-written; only once every chunk is complete, since others may be writing."""
        if self.place.path is not None:
            with self.place.writing():
                for left in self.place.path.rglob("*.partial"):
                    discard(left)

    def note(self, **attributes: Any) -> None:
        """Keep attributes beside the description."""
        with self.place.writing():
            self.group = zarr.open_group(self.place.open(read_only=False), mode="r+").update_attributes(attributes)

    def fitted_rig(self, rig: RigBackend) -> BlackBoxRig:
        """A rig that does not end in a linear map, in the basis that the store was begun with."""
        return BlackBoxRig(rig, self.constant(BASIS).to(rig.rest_vertices))


def checksum(values: np.ndarray) -> int:
    """The CRC-32C of an array's numbers."""
    return google_crc32c.value(np.ascontiguousarray(values).view(np.uint8).reshape(-1))


def description_sum(facts: dict[str, Any]) -> str:
    """The SHA-256 of a description."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def _make(store: Any, layout: Layout, facts: dict[str, Any], constants: dict[str, np.ndarray]) -> None:
    group = zarr.open_group(store, mode="w", zarr_format=3)
    for name, plan in layout.plans().items():
        array = plan.create_in(group, name)
        if name in constants:
            array[:] = constants[name]
    group.update_attributes({ATTRIBUTE: facts, SUM: description_sum(facts)})  # last: now it is begun


def _planned(place: Place, group: zarr.Group, name: str, plan: Any) -> zarr.Array:
    try:
        array = group[name]
    except (*UNREADABLE, FileNotFoundError) as error:
        raise DamagedError(
            f"{place}/{name}/zarr.json: missing or damaged ({_first_line(error)}): sample another store"
        ) from None
    if not isinstance(array, zarr.Array) or not plan.describes(array):
        raise DamagedError(f"{place}/{name}/zarr.json: altered since it was written: sample another store")
    return array


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
