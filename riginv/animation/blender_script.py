"""A script that keys the curves in Blender, on existing controls or on a new object."""

from pathlib import Path

from riginv.animation.animation import Animation
from riginv.animation.table import CURVES, SIDECAR
from riginv.rig.interface import RigBackend
from riginv.runs.files import write_text

FILE = "key_in_blender.py"
TEMPLATE = Path(__file__).parent / "in_blender" / "key_curves.py"


def check(rig: RigBackend) -> None:
    """Accept every rig: all controls can be keyed."""


def write(path: Path, animation: Animation) -> None:
    """Write the script; it reads curves.csv and curves.json beside it."""
    text = TEMPLATE.read_text(encoding="utf-8")
    write_text(path, text.replace("curves.csv", CURVES).replace("curves.json", SIDECAR))
