"""Compile the kernels: on installation, or on first use in a source tree.

Imports the standard library only: an installer runs this before riginv's dependencies are installed.
"""

import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

SOURCE = Path(__file__).parent / "source"
FLAGS = ("-std=c11", "-O3", "-shared", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast", "-fopenmp-simd")
# A processor runs the last of these that it supports. They are named, not "native": an installed library may be copied to
# another machine.
LEVELS: dict[str, tuple[str, ...]] = {"plain": ()}
if platform.machine().lower() in ("x86_64", "amd64"):
    LEVELS["avx2"] = ("-mavx2", "-mfma", "-mf16c")
ENDING = ".dll" if sys.platform == "win32" else ".so"
SECONDS = 120  # of one compilation, at most


class CompilationError(RuntimeError):
    """There is no C compiler, or it failed."""


def source_digest() -> str:
    """The digest of the kernels' source and compiler flags, which a compiled library holds."""
    digest = hashlib.sha256(repr((FLAGS, LEVELS)).encode())
    for path in sorted(SOURCE.iterdir()):
        if path.suffix in (".c", ".h"):
            digest.update(path.name.encode() + path.read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()[:16]


def library_name(level: str) -> str:
    """The file name of the library for a level of instructions."""
    return f"compiled-{level}{ENDING}"


def find_compiler() -> list[str] | None:
    """The command of a C compiler: `$CC`, one of the system's, or that of the package `ziglang`; None where there is none."""
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        found = shutil.which(name) if name else None
        if found:
            return [found]
    if importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    return None


def compile_library(out: Path, level: str) -> None:
    """Compile the kernels into a file, atomically.

    Args:
        out: the shared library.
        level: a key of `LEVELS`.

    Raises:
        CompilationError: there is no C compiler, or it failed; the message says which.
    """
    compiler = find_compiler()
    if compiler is None:
        raise CompilationError("no C compiler found (cc, gcc or clang)")
    out.parent.mkdir(parents=True, exist_ok=True)
    beside = out.with_name(f".{out.name}.{os.getpid()}.part")
    flags = [*FLAGS, *LEVELS[level], *([] if sys.platform == "win32" else ["-fPIC"]), f'-DRIGINV_SOURCE="{source_digest()}"']
    command = [*compiler, *flags, str(SOURCE / "kernels.c"), "-o", str(beside), *([] if sys.platform == "win32" else ["-lm"])]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS)
        if done.returncode or not beside.is_file():
            output = (done.stderr or done.stdout).strip().splitlines()
            raise CompilationError(f"{' '.join(compiler)} failed: {output[-1] if output else f'exit code {done.returncode}'}")
        os.replace(beside, out)
    except (OSError, subprocess.SubprocessError) as error:
        raise CompilationError(f"{' '.join(compiler)} failed: {error}") from None
    finally:
        beside.unlink(missing_ok=True)
