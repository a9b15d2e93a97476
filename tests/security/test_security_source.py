"""What the source never does: unpickle, evaluate text, run a shell, open a port; and what a session of ours never opens."""

import ast
import socket
import sys
from pathlib import Path

import pytest

from riginv.tracking.viewer.page import write_viewer
from riginv.tracking.viewer.tensorboard import write_tensorboard
from tests.support.animations import errors_of, moving
from tests.support.toys import ToyRig

ROOT = Path(__file__).parents[2]
SOURCES = [path for folder in ("riginv", "rigs") for path in sorted((ROOT / folder).rglob("*.py"))]
MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "jsonpickle", "joblib.numpy_pickle", "code", "pty"}
SERVERS = {
    "http.server",
    "socketserver",
    "xmlrpc.server",
    "wsgiref",
    "flask",
    "fastapi",
    "uvicorn",
    "tornado",
    "aiohttp",
    "socket",
}
CALLS = {  # what may be called, and with what: None: never
    "eval": None,
    "exec": None,
    "compile": None,
    "__import__": None,
    "os.system": None,
    "os.popen": None,
    "os.exec*": None,
    "os.spawn*": None,
    "yaml.load": None,
    "yaml.unsafe_load": None,
    "yaml.full_load": None,
    "subprocess.getoutput": None,
    "subprocess.getstatusoutput": None,
    "hydra.utils.instantiate": None,
    "instantiate": None,
    "tarfile.open": None,
    "zipfile.ZipFile.extractall": None,
    "shutil.unpack_archive": None,
    "np.load": ("allow_pickle", False),
    "numpy.load": ("allow_pickle", False),
    "torch.load": ("weights_only", True),
}
METHODS = {
    "extractall": None,
    "load_from_checkpoint": None,
    "read_pickle": None,
    "create_server": None,
    "listen": None,
    "bind": None,
}
SHELL = ("subprocess.run", "subprocess.Popen", "subprocess.call", "subprocess.check_call", "subprocess.check_output")


def name_of(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f"{name_of(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else "?"


def faults(text: str) -> list[str]:
    """The forbidden imports and calls in a source, with their lines."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            found += [f"{node.lineno}: import {name}" for name in names if name in MODULES | SERVERS]
        if not isinstance(node, ast.Call):
            continue
        name, given = name_of(node.func), {keyword.arg: keyword.value for keyword in node.keywords}
        for known, needed in CALLS.items():
            if name == known or (known.endswith("*") and name.startswith(known[:-1])):
                value = given.get(needed[0]) if needed else None
                if not (isinstance(value, ast.Constant) and value.value is needed[1]):
                    found.append(f"{node.lineno}: {name}")
        if isinstance(node.func, ast.Attribute) and node.func.attr in METHODS and not is_binding(node):
            found.append(f"{node.lineno}: .{node.func.attr}")
        if name in SHELL and "shell" in given:
            found.append(f"{node.lineno}: {name} with shell=")
    return found


def is_binding(node: ast.Call) -> bool:
    """`inspect.signature(...).bind(...)` binds arguments, not ports."""
    return (
        node.func.attr == "bind"
        and isinstance(node.func.value, ast.Call)
        and name_of(node.func.value.func) == "inspect.signature"
    )


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_load_path_can_run_code_and_nothing_listens(path):
    assert not faults(path.read_text()), path


@pytest.mark.parametrize(
    "text",
    [
        "import pickle",
        "from marshal import loads",
        "np.load(path)",
        "np.load(path, allow_pickle=True)",
        "torch.load(path, weights_only=False)",
        "torch.load(path)",
        "eval(text)",
        "os.system('x')",
        "os.execvp('x', [])",
        "yaml.load(text)",
        "subprocess.run('x', shell=True)",
        "archive.extractall()",
        "import http.server",
        "server.bind(('', 80))",
        "Module.load_from_checkpoint(path)",
    ],
)
def test_the_walk_finds_what_it_is_for(text):
    assert faults(text)


HEARD: list[str] | None = None  # what is done with sockets, while anyone listens


def hear(event: str, given: tuple) -> None:
    if HEARD is not None and event in ("socket.bind", "socket.listen", "socket.connect", "socket.sendto", "socket.getaddrinfo"):
        HEARD.append(f"{event} {given[1:]}")


def test_training_and_looking_open_no_port_and_call_nobody(run, tmp_path, monkeypatch):
    """A whole small training, and the page and the events of an inversion, with every socket watched."""
    sys.addaudithook(hear)  # for good, but deaf after this test
    monkeypatch.setattr(sys.modules[__name__], "HEARD", [])
    with socket.create_server(("127.0.0.1", 0)):
        assert HEARD, "the ear is deaf"
    HEARD.clear()
    outcome = run("train", "trainer.max_steps=1", "data.batch_size=2", "evaluation.test_poses=2")
    assert outcome.code == 0, outcome.text
    animation = moving(ToyRig(), with_motion=False)
    write_viewer(tmp_path / "look.html", animation, errors_of(animation), lambda rows: animation.rig(animation.controls[rows]))
    write_tensorboard(tmp_path / "board", animation, errors_of(animation))
    assert not HEARD
