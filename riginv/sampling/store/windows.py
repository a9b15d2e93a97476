"""Order of training on a store: chunks are shuffled each epoch, and mixed within windows of several chunks."""

from bisect import bisect_right
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from itertools import accumulate

import numpy as np
import torch
from torch import Tensor

from riginv.rig.batches import generator_at
from riginv.sampling.store.layout import COEFFICIENTS, CONTROLS, Layout
from riginv.sampling.store.store import PoseStore

WINDOW_BYTES, FEWEST_CHUNKS = 128e6, 4
READ = (CONTROLS, COEFFICIENTS)
WindowIndex = tuple[int, int]  # epoch, and window of the epoch


class WindowOrder:
    """Order of poses, a function of the sizes and a seed.

    Attributes:
        chunks: per window; the last window of an epoch may have fewer.
    """

    def __init__(self, layout: Layout, seed: int) -> None:
        self.layout, self.seed = layout, seed
        self.chunks = max(FEWEST_CHUNKS, int(WINDOW_BYTES // (layout.bytes_per_pose * layout.chunk)))
        self.windows = lru_cache(maxsize=2)(self._windows)

    def _windows(self, epoch: int) -> tuple[list[list[int]], list[int]]:
        """Chunks of each window of an epoch, and the number of poses before each window."""
        order = torch.randperm(self.layout.chunks, generator=generator_at(self.seed, "order of chunks", epoch)).tolist()
        windows = [order[start : start + self.chunks] for start in range(0, len(order), self.chunks)]
        sizes = [sum(self.layout.count(chunk) for chunk in window) for window in windows]
        return windows, [0, *accumulate(sizes)]

    def find(self, position: int) -> tuple[WindowIndex, int]:
        """Window of a position in the endless stream of poses, and the position within it."""
        epoch, position = divmod(position, self.layout.samples)
        starts = self.windows(epoch)[1]
        number = bisect_right(starts, position) - 1
        return (epoch, number), position - starts[number]

    def after(self, window: WindowIndex) -> WindowIndex:
        """The next window."""
        epoch, number = window
        return (epoch, number + 1) if number + 1 < len(self.windows(epoch)[0]) else (epoch + 1, 0)

    def rows(self, window: WindowIndex, size: int) -> Tensor:
        """Order of the poses within a window."""
        return torch.randperm(size, generator=generator_at(self.seed, "order of poses", *window))


class WindowReader:
    """Poses in the order of training: one window in memory, the next one read in the background."""

    def __init__(self, store: PoseStore, seed: int) -> None:
        self.store, self.order = store, WindowOrder(store.layout, seed)
        self.ledger = store.ledger()[0]
        self._at: WindowIndex | None = None
        self._window: dict[str, Tensor] = {}
        self._next: tuple[WindowIndex, Future] | None = None
        self._thread: ThreadPoolExecutor | None = None

    def __getstate__(self) -> dict:
        return {**self.__dict__, "_next": None, "_thread": None}

    def poses(self, start: int, count: int) -> dict[str, Tensor]:
        """Poses `start` to `start + count` of the stream: `controls` and `coefficients`, float32.

        Raises:
            DamagedError: a chunk cannot be read, or differs from what was written.
        """
        parts: list[dict[str, Tensor]] = []
        while count:
            window, offset = self.order.find(start)
            self._go_to(window)
            rows = self._rows[offset : offset + count]
            parts.append({name: self._window[name][rows].float() for name in READ})
            start, count = start + len(rows), count - len(rows)
        return {name: torch.cat([part[name] for part in parts]) for name in READ}

    def _go_to(self, window: WindowIndex) -> None:
        if window == self._at:
            return
        waiting, self._next, self._window = self._next, None, {}
        self._window = waiting[1].result() if waiting and waiting[0] == window else self._read(window)
        self._rows = self.order.rows(window, len(self._window[CONTROLS]))
        self._at, following = window, self.order.after(window)
        self._thread = self._thread or ThreadPoolExecutor(1, "riginv-read-ahead")
        self._next = following, self._thread.submit(self._read, following)

    def _read(self, window: WindowIndex) -> dict[str, Tensor]:
        chunks = self.order.windows(window[0])[0][window[1]]
        size, layout = sum(self.store.layout.count(chunk) for chunk in chunks), self.store.layout
        found = {}
        for name in READ:
            values = np.empty((size, *self.store.arrays[name].shape[1:]), self.store.arrays[name].dtype)
            start = 0
            for chunk in chunks:
                stop = start + layout.count(chunk)
                values[start:stop] = self.store.read_checked(name, chunk, self.ledger[chunk])
                start = stop
            found[name] = torch.from_numpy(values)
        return found
