"""Commands as processes that can be killed, on disks that can be full: nothing is pretended, the kernel does it."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.conftest import ROOT

PATIENCE_S = 400.0
TICK_S = 0.01
ENVIRONMENT = {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1"}
NAMESPACES = (["unshare", "--mount"], ["unshare", "--map-root-user", "--mount"])  # as root, and as anybody else


def own_mounts() -> list[str] | None:
    """What gives a process mounts that no other sees, and that end with it; None where the system does not let us."""
    if shutil.which("unshare") is None or shutil.which("nsenter") is None:
        return None
    mount = ["mount", "-t", "tmpfs", "none", "/mnt"]
    return next((how for how in NAMESPACES if not subprocess.run([*how, *mount], capture_output=True).returncode), None)


@dataclass
class Running:
    """A command that runs, or has ended."""

    commands: "Commands"
    process: int
    log: Path
    began: float
    code: int | None = None
    seconds: float = 0.0

    @property
    def said(self) -> str:
        """All that it has printed."""
        return self.commands.seen(self.log).read_text(errors="replace") if self.commands.seen(self.log).exists() else ""

    def ends_within(self, seconds: float) -> bool:
        end = time.monotonic() + seconds
        while self.code is None:
            self.code = self.commands.ask({"process": self.process})
            self.seconds = time.monotonic() - self.began
            if self.code is None and time.monotonic() > end:
                return False
            time.sleep(TICK_S if self.code is None else 0)
        return True

    def wait(self) -> int:
        """Its exit code, once it has ended."""
        assert self.ends_within(PATIENCE_S), f"it hangs: {self.said}"
        return self.code

    def kill(self) -> None:
        """Kill it and all that it has started."""
        for kill in (os.kill, os.killpg):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                kill(self.process, signal.SIGKILL)


class Commands:
    """Starts commands, each forked from a process that has imported everything; to be entered."""

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        self.environment, self.namespace = dict(environment or {}), own_mounts()
        self._started: list[Running] = []

    def __enter__(self) -> "Commands":
        self._server = subprocess.Popen(
            [*(self.namespace or []), sys.executable, "-m", "tests.faults.preloaded"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            cwd=ROOT,
            env={**os.environ, **ENVIRONMENT, **self.environment},
            text=True,
        )
        assert json.loads(self._server.stdout.readline()) == "ready"
        return self

    def __exit__(self, *_: object) -> None:
        for running in self._started:
            if running.code is None:  # a test was stopped in its midst
                running.kill()
        self._server.kill()
        self._server.communicate()

    def start(self, name: str, arguments: Sequence[str], folder: Path) -> Running:
        """Start a command in a folder."""
        log = folder.with_name(f"{folder.name}.{time.monotonic_ns()}.log")
        began = time.monotonic()
        process = self.ask({"name": name, "arguments": list(arguments), "folder": str(folder), "log": str(log)})
        self._started.append(Running(self, process, log, began))
        return self._started[-1]

    def run(self, name: str, arguments: Sequence[str], folder: Path, kill_after_s: float = PATIENCE_S) -> Running:
        """Run a command in a folder to its end, or kill it after a while."""
        running = self.start(name, arguments, folder)
        if not running.ends_within(kill_after_s):
            running.kill()
            running.wait()
        return running

    def ask(self, request: Mapping[str, Any]) -> Any:
        self._server.stdin.write(json.dumps(request) + "\n")
        self._server.stdin.flush()
        return json.loads(self._server.stdout.readline())

    def mount(self, *arguments: str) -> None:
        """Mount something that only the commands see."""
        user = ["-U", "--preserve-credentials"] if "--map-root-user" in self.namespace else []
        subprocess.run(["nsenter", "-t", str(self._server.pid), *user, "-m", "mount", *arguments], check=True)

    def seen(self, path: Path) -> Path:
        """A path as the commands see it."""
        return Path(f"/proc/{self._server.pid}/root{path}") if self.namespace else path
