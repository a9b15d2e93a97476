"""python -m riginv.store.worker: makes the chunks whose numbers come in, for `riginv.store.workers`.

The first line in is a JSON object with `place`, `rig` and `sampler`; each line after it is the number of a chunk. Each line out
is a JSON object: `done` with the number, or `error` with a sentence for the user, or `fault` with a traceback. It ends when no
more lines can come, because its parent ended or wants it to.
"""

import json
import os
import queue
import signal
import sys
import threading
import traceback
from typing import Any

import torch

from riginv.config.building import build
from riginv.errors import InputError
from riginv.rig.interface import LinearRig, RigBackend
from riginv.store.making import ChunkMaker, build_sampler
from riginv.store.place import Place
from riginv.store.store import PoseStore

GROWTH, AT_LEAST_KB = 3, 2_000_000  # a worker that has grown so much since its first chunk is replaced


def main() -> None:
    """Work until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent says when to stop
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a rig prints must not be taken for an answer
    torch.set_num_threads(1)
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_listen, args=(lines,), daemon=True).start()
    task = json.loads(lines.get())
    rig, maker, first = None, None, None
    while True:
        try:
            rig = rig or build(task["rig"])
            chunk = int(lines.get())
            maker = maker or chunk_maker(task, rig)
            maker.make(chunk)
            used = _peak_kb()
            first = first or used
            answer: dict[str, Any] = {"done": chunk, "tired": used > max(AT_LEAST_KB, GROWTH * first)}
        except InputError as error:
            answer = {"error": str(error)}
        except Exception:
            answer = {"fault": traceback.format_exc()}
        print(json.dumps(answer), file=answers, flush=True)


def chunk_maker(task: dict[str, Any], rig: RigBackend) -> ChunkMaker:
    """What makes the chunks of an existing store."""
    store = PoseStore.find(Place(task["place"]), read_only=False)
    if store is None:
        raise InputError(f"{task['place']}: the store is gone")
    linear = rig if isinstance(rig, LinearRig) else store.fitted_rig(rig)
    return ChunkMaker(store, linear, build_sampler(task["sampler"], linear))


def _listen(lines: queue.Queue) -> None:
    for line in sys.stdin:
        lines.put(line)
    os._exit(0)  # at once, in the middle of a chunk, too: nobody waits for it


def _peak_kb() -> int:
    """The most memory that this process has held, kB; 0 where nobody can say."""
    try:
        import resource
    except ImportError:
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main()
