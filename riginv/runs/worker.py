"""The worker side of `riginv.runs.worker_pool` for workers that are modules of Python."""

import os
import queue
import signal
import threading
import traceback
from collections.abc import Callable
from typing import IO, Any

from riginv.errors import InputError
from riginv.runs.worker_process import GREETING, Message, read_message, write_message


def serve(answer: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Answer requests until the input ends, which ends the process at once, also in the middle of a request.

    Args:
        answer: from the header of a request, with its `command`, to that of the answer; an InputError is a refusal.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    incoming, outgoing = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # prints go to standard error
    outgoing.write(GREETING)
    outgoing.flush()
    requests: queue.Queue[Message] = queue.Queue()
    threading.Thread(target=_listen, args=(incoming, requests), daemon=True).start()
    while True:
        header, _ = requests.get()
        try:
            found = answer(header)
        except InputError as error:
            found = {"error": str(error)}
        except Exception:
            found = {"fault": traceback.format_exc()}
        write_message(outgoing, found, {})


def _listen(incoming: IO[bytes], requests: queue.Queue) -> None:
    while True:
        try:
            requests.put(read_message(incoming))
        except EOFError:
            os._exit(0)
