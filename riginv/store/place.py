"""Where a store lies: a folder, or anywhere that fsspec can write."""

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


class Place:
    """Where a store lies or shall lie.

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
        """As zarr sees it.

        Raises:
            InputError: nothing speaks such a URL here.
        """
        if self.path is not None:
            return LocalStore(self.path, read_only=read_only)
        try:
            return FsspecStore.from_url(self.text, read_only=read_only)
        except (ImportError, ValueError) as error:
            raise InputError(f"{self}: cannot be reached: {str(error).splitlines()[0]}") from None

    def holds_other_things(self) -> bool:
        """Whether a local place is taken by something that is no zarr group."""
        if self.path is None or not self.path.exists():
            return False
        return not self.path.is_dir() or (any(self.path.iterdir()) and not (self.path / "zarr.json").exists())

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Say in one sentence that a disk is full, or that nothing can be written here.

        Raises:
            InputError: so it is.
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
        """Keep other processes out of a local place meanwhile; a remote one cannot be locked.

        Args:
            purpose: what others may not do at the same time.
            refusal: what to say where another process is at it; None: wait for it.

        Raises:
            InputError: another process is at it.
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
            discard(Path(lock.lock_file))  # while it is held: who comes now makes a new one
            lock.release()
