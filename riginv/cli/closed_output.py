"""Ending without a traceback where whoever reads the output has stopped reading, as `head` does."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO


@contextmanager
def ends_with_its_reader() -> Iterator[None]:
    """Within it a command ends with exit status 1, and no traceback, once its output is closed."""
    try:
        yield
    except BaseException:
        _end_if_closed()
        raise
    _end_if_closed()


def _end_if_closed() -> None:
    closed = [stream for stream in (sys.stdout, sys.stderr) if _is_closed(stream)]
    for stream in closed:  # what is still to be written goes nowhere: Python would complain of it when it ends
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())
    if closed:
        sys.exit(1)


def _is_closed(stream: TextIO) -> bool:
    try:
        stream.flush()
    except BrokenPipeError:
        return True
    except (OSError, ValueError):  # a full disk, or closed by ourselves: not for here
        return False
    return False
