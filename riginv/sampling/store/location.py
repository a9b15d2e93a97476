"""Locations of stores: folders, or anything that fsspec can write."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import unquote, urlparse

from filelock import FileLock, Timeout
from zarr.abc.store import Store
from zarr.storage import FsspecStore, LocalStore

from riginv.errors import InputError
from riginv.runs.files import discard


class StoreLocation:
    """Location of a store, which may not exist yet.

    Args:
        text: a path, or a URL such as `s3://bucket/poses.zarr`; `file:///path` is a path.

    Attributes:
        path: of a local store, else None.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        parsed = urlparse(text)
        remote = "://" in text and parsed.scheme != "file"
        self.path = None if remote else Path(unquote(parsed.path) if "://" in text else text)

    def __str__(self) -> str:
        return self.text

    def open(self, read_only: bool = True) -> Store:
        """The zarr store.

        Raises:
            InputError: the URL is not supported here.
        """
        if self.path is not None:
            return LocalStore(self.path, read_only=read_only)
        try:
            return FsspecStore.from_url(self.text, read_only=read_only)
        except (ImportError, ValueError) as error:
            raise InputError(f"{self}: cannot be reached: {str(error).splitlines()[0]}") from None

    def holds_other_things(self) -> bool:
        """Whether a local path is occupied by something that is no zarr group."""
        if self.path is None or not self.path.exists():
            return False
        return not self.path.is_dir() or (any(self.path.iterdir()) and not (self.path / "zarr.json").exists())

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Convert write errors, such as a full disk, to one sentence.

        Raises:
            InputError: a write fails.
        """
        try:
            yield
        except OSError as error:
            reason = os.strerror(error.errno) if error.errno else str(error)
            raise InputError(
                f"{self}: cannot be written: {reason}; mend that and give the same command again: what is complete is kept"
            ) from None

    @contextmanager
    def exclusive_lock(self, purpose: str, refusal: str | None = None) -> Iterator[None]:
        """Exclude other processes from a local store; remote ones cannot be locked.

        Args:
            purpose: name of the exclusive operation.
            refusal: message where another process has the lock; None: wait for it.

        Raises:
            InputError: another process has the lock.
        """
        if self.path is None:
            yield
            return
        lock = FileLock(self.path.with_name(f".{self.path.name}.{purpose}.lock"))
        with self.writing():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                lock.acquire(timeout=-1 if refusal is None else 0)
            except Timeout:
                raise InputError(f"{self}: {refusal}") from None
        try:
            yield
        finally:
            discard(Path(lock.lock_file))  # while it is held: later processes create a new one
            lock.release()
