"""Quiet exit on a broken pipe (`| head`) and on Ctrl-C, and filters of known warnings."""

import logging
import os
import select
import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn, TextIO

INTERRUPTED = 128 + signal.SIGINT  # the exit status after Ctrl-C, as shells have it


@contextmanager
def exit_on_broken_pipe() -> Iterator[None]:
    """A context in which a command exits with status 1, without a traceback, once its output is closed."""
    try:
        yield
    except SystemExit:
        _end_if_any(_closed_while_flushing())
        raise
    except Exception as error:
        if _is_broken_pipe(error):
            _end_if_any([stream for stream in _streams() if _has_no_reader(stream)])
        raise
    _end_if_any(_closed_while_flushing())


def _end_if_any(closed: list[TextIO]) -> None:
    for stream in closed:  # discard unwritten output, which Python would flush with an error at exit
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())
    if closed:
        raise SystemExit(1)


def _closed_while_flushing() -> list[TextIO]:
    """The streams with unwritten text whose reader has closed them."""
    closed = []
    for stream in _streams():
        try:
            stream.flush()
        except BrokenPipeError:
            closed.append(stream)
        except (OSError, ValueError):  # a full disk, or closed by ourselves: not for here
            pass
    return closed


def _is_broken_pipe(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, BrokenPipeError):
            return True
        error = error.__cause__ or error.__context__
    return False


def _has_no_reader(stream: TextIO) -> bool:
    """Whether a stream is a pipe without a reader; distinguishes the command's output from a broken pipe to a worker."""
    if not hasattr(select, "poll"):
        return True
    poll = select.poll()
    poll.register(stream.fileno(), select.POLLOUT)
    return any(events & (select.POLLERR | select.POLLHUP) for _, events in poll.poll(0))


def _streams() -> list[TextIO]:
    """Standard output and standard error, where they are files of the system."""
    found = []
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.fileno()
        except (AttributeError, OSError, ValueError):
            continue
        found.append(stream)
    return found


def interrupt_at_once() -> None:
    """Let Ctrl-C end the process without a traceback, until `interrupt_as_exception`; for the seconds of imports."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored, as in the background of a shell
        signal.signal(signal.SIGINT, _exit_at_once)


def interrupt_as_exception() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again."""
    if signal.getsignal(signal.SIGINT) is _exit_at_once:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def stop_interrupted(interruption: BaseException) -> NoReturn:
    """Exit after Ctrl-C.

    Args:
        interruption: its text, if any, says what is kept and how to go on.
    """
    print(f"\nstopped: {interruption if interruption.args else 'nothing is left half-written'}", file=sys.stderr)
    sys.exit(INTERRUPTED)


def _exit_at_once(*_: object) -> NoReturn:
    print("\nstopped before it began", file=sys.stderr, flush=True)
    os._exit(INTERRUPTED)


# Known and harmless warnings, each with the reason.
WARNINGS = (
    ".*isinstance\\(treespec, LeafSpec\\).*",  # lightning with torch 2.13
    ".*IterableDataset.*__len__.*",  # batches are drawn by number, in one process
    ".*number of training batches.*smaller than the logging interval.*",  # short runs still log each validation
    ".*does not have many workers.*",  # drawing a batch is cheaper than moving it between processes
    ".*Checkpoint directory.*exists and is not empty.*",  # checked by riginv.runs.run_folder
    ".*resuming from a checkpoint that ended before the epoch.*",  # riginv.training.data goes on at the right batch
    ".*Experiment logs directory.*exists.*",
    ".*recommended to use `self.log.*sync_dist=True.*",  # what is logged is that of all processes already
    ".*`broadcast_buffers` is deprecated.*",  # its successor is not in every torch that riginv runs with
    ".*does not have a deterministic implementation.*",  # deterministic=warn: where there is one it is used
)


def filter_warnings() -> None:
    """Silence the warnings above and Lightning's start-up messages."""
    for message in WARNINGS:
        warnings.filterwarnings("ignore", message=message)
    for name in ("lightning", "lightning.pytorch", "lightning.fabric", "lightning.pytorch.utilities.rank_zero"):
        logging.getLogger(name).setLevel(logging.ERROR)
