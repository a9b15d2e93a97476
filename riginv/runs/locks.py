"""Exclusive locks of files and folders, which the operating system releases when the process ends."""

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
    """Another process uses a folder."""


def lock_folder(folder: Path) -> bool:
    """Lock a folder for this process, until `unlock_folder` or the end of the process; a missing folder is made.

    Returns:
        Whether this call has locked it: False where this process had locked it before.

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
    """Release the lock of a folder, if this process has it."""
    lock = _held.pop(folder.resolve(), None)
    if lock is None:
        return
    if folder.is_dir() and set(folder.iterdir()) == {folder / LOCK}:
        discard(folder / LOCK)  # the run wrote nothing
    lock.release()


def unlock_folders() -> None:
    """Release all folder locks of this process."""
    for folder in list(_held):
        unlock_folder(folder)


@contextmanager
def exclusive_lock(path: Path) -> Iterator[None]:
    """A context that locks a file or a folder against other processes, and removes partial files of killed ones.

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
        with suppress(OSError):  # while it is locked: another process that has it open finds it removed
            beside.unlink()
        lock.release()


def _locked(file: Path, of: Path) -> FileLock:
    lock = FileLock(file, timeout=0, thread_local=False)
    try:
        lock.acquire()
    except Timeout:
        owner = ""
        with suppress(OSError):
            owner = file.read_text(encoding="utf-8", errors="replace")[:80].strip()
        if owner:
            problem = f"in use by another process ({owner}): wait until it has ended, end it, or choose another place"
        else:  # a file system without locks fails in the same way
            problem = "in use by another process, or its file system has no locks: wait, or choose another place"
        raise FolderInUseError(f"{of} is {problem}") from None
    with suppress(OSError):  # for users who look into the file
        file.write_text(f"process {os.getpid()} on {platform.node()}\n", encoding="utf-8")
    return lock
