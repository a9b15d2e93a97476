"""Commands of riginv in processes of their own that start at once: forked from this one, which has imported everything.

python -m tests.faults.preloaded answers a line of JSON with a line: {"name", "arguments", "folder", "log"} starts a command,
and its process id is the answer; {"process": ID} asks for its exit code, `null` while it runs.
"""

import importlib
import json
import os
import sys
import traceback
from typing import Any, NoReturn

from riginv import export_onnx, invert, sample, train
from riginv.launch.command import command

COMMANDS = {
    "train": train.train,
    "sample": sample.sample,
    "invert": invert.invert,
    "export_onnx": export_onnx.export_onnx,
}
ALSO = (
    "torch.onnx",
    "torch.export",
    "torch._dynamo",
    "onnxruntime",
    "onnxscript",
    "tensorboard.summary",
    "trimesh",
    "tests.support.toys",
)


def become(name: str, arguments: list[str], folder: str, log: str) -> NoReturn:
    """Become a command line of its own."""
    os.setsid()
    os.chdir(folder)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(output, stream)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    sys.argv = [f"riginv.{name}", *arguments]
    code = 1
    try:
        command(name)(COMMANDS[name])()
        code = 0
    except SystemExit as end:
        code = end.code or 0
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # libraries would wait for threads that a fork leaves behind


def exit_code(process: int) -> int | None:
    """Of a process that was started here; None while it runs."""
    ended, status = os.waitpid(process, os.WNOHANG)
    return os.waitstatus_to_exitcode(status) if ended else None


def answer(value: Any) -> None:
    print(json.dumps(value), flush=True)


def main() -> None:
    for name in ALSO:
        if importlib.util.find_spec(name.partition(".")[0]) is not None:
            importlib.import_module(name)
    answer("ready")
    for line in sys.stdin:
        request = json.loads(line)
        if "process" in request:
            answer(exit_code(request["process"]))
            continue
        process = os.fork()
        if process == 0:
            become(**request)
        answer(process)


if __name__ == "__main__":
    main()
