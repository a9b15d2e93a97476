"""One process at a time in a folder: locks of the operating system, which go with the process however it ends."""

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from riginv.errors import InputError
from riginv.runs.files import discard, stale_partial_files

LOCK = ".lock"

_held: dict[Path, FileLock] = {}


class FolderInUseError(InputError):
    """Another process is at work in a folder."""


def lock_folder(folder: Path) -> bool:
    """Lock a folder for this process, until `unlock_folder` or the end of the process; the folder is made where it is missing.

    Returns:
        whether it was not this process's before.

    Raises:
        FolderInUseError: another process has it.
        OSError: nothing can be written there.
    """
    if folder.resolve() in _held:
        return False
    folder.mkdir(parents=True, exist_ok=True)
    _held[folder.resolve()] = _locked(folder / LOCK, folder)
    return True


def unlock_folder(folder: Path) -> None:
    """Give a folder back, if this process has it."""
    lock = _held.pop(folder.resolve(), None)
    if lock is None:
        return
    if folder.is_dir() and set(folder.iterdir()) == {folder / LOCK}:
        discard(folder / LOCK)  # nothing came of the run
    lock.release()


def unlock_folders() -> None:
    """Give back all folders that this process has."""
    for folder in list(_held):
        unlock_folder(folder)


@contextmanager
def exclusive_lock(path: Path) -> Iterator[None]:
    """Let no other process write a file or a folder meanwhile, and clear away what killed ones left of it half-written.

    Raises:
        FolderInUseError: another process writes it.
        OSError: nothing can be written beside it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}{LOCK}")
    lock = _locked(beside, path)
    try:
        for left in stale_partial_files(path):
            discard(left)
        yield
    finally:
        with suppress(OSError):  # while it is locked: whoever has it open finds that it has no name any more
            beside.unlink()
        lock.release()


def _locked(file: Path, of: Path) -> FileLock:
    lock = FileLock(file, timeout=0, thread_local=False)
    try:
        lock.acquire()
    except Timeout:
        with suppress(OSError):
            raise FolderInUseError(
                f"{of} is in use by another process ({file.read_text(encoding='utf-8', errors='replace')[:80].strip()}): "
                f"wait until it has ended, end it, or choose another place"
            ) from None
        raise FolderInUseError(f"{of} is in use by another process: wait until it has ended, or choose another place") from None
    with suppress(OSError):  # it is there to be read by people
        file.write_text(f"process {os.getpid()} on {platform.node()}\n", encoding="utf-8")
    return lock
