"""The Blender twin of a rig: a .blend that is exported once and cached."""

import atexit
import contextlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.runs.cache import cache_folder, code_key
from riginv.runs.files import atomic_write
from rigs.blender.blueprint import Blueprint
from rigs.blender.body import body_blueprint
from rigs.blender.face import face_blueprint
from rigs.blender.interpreter import SCRIPTS, script_command
from rigs.body import BodyRig
from rigs.face import FaceRig

BUILDER = "build_blend.py"
LONGEST_S = 900.0


def blueprint_of(rig: RigBackend) -> Blueprint:
    """Blueprint of one of the default rigs.

    Raises:
        InputError: the rig has none.
    """
    if isinstance(rig, FaceRig):
        return face_blueprint(rig)
    if isinstance(rig, BodyRig):
        return body_blueprint(rig)
    raise InputError(
        f"rig '{rig.name}' cannot be rebuilt in Blender: only rig=face and rig=body can; name a .blend with rig.file="
    )


def write_blend(blueprint: Blueprint, out: Path, interpreter: str) -> None:
    """Build a .blend from a blueprint, atomically.

    Raises:
        InputError: Blender failed.
    """
    with tempfile.TemporaryDirectory(prefix="riginv-blend-") as folder, atomic_write(out) as partial:
        saved, built = Path(folder) / "blueprint.npz", Path(folder) / "built.blend"
        blueprint.save(saved)
        command = script_command(interpreter, BUILDER, str(saved), str(built))
        environment = {**os.environ, "TMPDIR": folder}  # removed with the folder
        try:
            done = subprocess.run(
                command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=LONGEST_S
            )
        except (subprocess.TimeoutExpired, OSError) as error:
            raise InputError(f"{interpreter} could not build {out}: {error}") from None
        if done.returncode or not built.is_file():
            lines = [line.strip() for line in (done.stdout + done.stderr).splitlines() if line.strip()]
            raise InputError(f"{interpreter} could not build {out}: {lines[-1] if lines else 'no output'}")
        shutil.copyfile(built, partial)


def twin_file(rig: RigBackend, interpreter: str) -> Path:
    """The .blend of a rig's twin, cached by its content and the code that builds it."""
    blueprint = blueprint_of(rig)
    code = code_key([SCRIPTS / BUILDER, SCRIPTS / "drivers.py"])
    name = f"blender/{blueprint.name}-{blueprint.content_hash()[:16]}-{code}.blend"
    kept = cache_folder() / name
    if not kept.is_file():
        with contextlib.suppress(OSError):
            write_blend(blueprint, kept, interpreter)
    if kept.is_file():
        return kept
    folder = tempfile.mkdtemp(prefix="riginv-twin-")  # the cache cannot be written
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    write_blend(blueprint, Path(folder) / kept.name, interpreter)
    return Path(folder) / kept.name
