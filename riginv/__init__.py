"""Rig inversion: meshes to rig controls, evaluated on the true rig.

The public names are imported when they are first used, so that `import riginv` is quick:

    from riginv import load_inverse

    inverse = load_inverse("runs/face-inverse/2026-11-22_10-00-00")
    controls = inverse(vertices)  # (frame, vertex, 3) in mm -> (frame, control)
"""

import importlib
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from riginv.errors import InputError
    from riginv.inference.inverse import Inverse, load_inverse
    from riginv.rig.contract import ContractError, check_rig
    from riginv.rig.interface import Control, LinearRig, RigBackend

_HOMES = {
    "Control": "riginv.rig.interface",
    "LinearRig": "riginv.rig.interface",
    "RigBackend": "riginv.rig.interface",
    "check_rig": "riginv.rig.contract",
    "ContractError": "riginv.rig.contract",
    "load_inverse": "riginv.inference.inverse",
    "Inverse": "riginv.inference.inverse",
    "InputError": "riginv.errors",
}

__all__ = [
    "Control",
    "ContractError",
    "InputError",
    "Inverse",
    "LinearRig",
    "RigBackend",
    "check_rig",
    "load_inverse",
]

try:
    __version__ = version("riginv")
except PackageNotFoundError:  # a checkout on sys.path that was never installed
    __version__ = "0+unknown"


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'riginv' has no attribute '{name}'")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
