"""The program that runs the scripts of `in_blender/`: a Python with bpy, or Blender itself."""

import importlib.util
import os
import shutil
import sys
from pathlib import Path

from riginv.errors import InputError

VARIABLE = "RIGINV_BLENDER"
SCRIPTS = Path(__file__).parent / "in_blender"


def find_interpreter(given: str | None = None, key: str = "rig.interpreter") -> str:
    """The program given, or that of `$RIGINV_BLENDER`, or this Python where it has bpy.

    Args:
        key: of the config that gives it.

    Raises:
        InputError: there is none.
    """
    named = given or os.environ.get(VARIABLE)
    if named:
        found = shutil.which(named)
        if found is None:
            source = key if given else VARIABLE
            raise InputError(f"{source}={named}: there is no such program; name a Python that has bpy, or Blender itself")
        return found
    if importlib.util.find_spec("bpy") is None:
        raise InputError(
            "Blender is not installed here. Remedies: pip install 'riginv[blender]' (Python 3.11 only), or name an installed "
            "Blender (its program, or a Python with bpy): reading.interpreter=PATH for a clip, rig.interpreter=PATH for a rig, "
            f"the environment variable {VARIABLE} for both"
        )
    return sys.executable


def script_command(interpreter: str, script: str, *arguments: str) -> list[str]:
    """Command line that runs a script of `in_blender/`, by Blender itself where the program is named blender."""
    path = str(SCRIPTS / script)
    if Path(interpreter).name.lower().startswith("blender"):
        return [interpreter, "--background", "--factory-startup", "--python-exit-code", "1", "--python", path, "--", *arguments]
    return [interpreter, path, *arguments]
