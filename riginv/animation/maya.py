"""Maya .anim: a curve for each control, for a node that has the controls as attributes.

Source: Maya's manual, "ANIM file format", version 1.1.
"""

import re
from pathlib import Path

import numpy as np

from riginv.animation.animation import Animation
from riginv.animation.text import digits, rigid_motion_columns
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.runs.files import write_text

FILE = "curves.anim"
TIME_UNITS: dict[float, str] = {15: "game", 24: "film", 25: "pal", 30: "ntsc", 48: "show", 50: "palf", 60: "ntscf"}
OUTPUTS = {"": "unitless", "deg": "angular", "mm": "linear"}
MOTION = ("translateX", "translateY", "translateZ", "rotateX", "rotateY", "rotateZ")


def check(rig: RigBackend) -> None:
    """Raise InputError if two controls would have the same name in Maya."""
    names: dict[str, str] = {}
    for name in rig.control_names:
        other = names.setdefault(legal(name), name)
        if other != name:
            raise InputError(
                f"formats: anim cannot hold rig '{rig.name}': its controls '{other}' and '{name}' are both '{legal(name)}' "
                f"in Maya, where names are letters, digits and underscores; rename one of them"
            )


def write(path: Path, animation: Animation) -> None:
    """Write a curve for each control on the node `RIG_controls`, and the rigid motion, if any, on `RIG_motion`.

    Times are frames if Maya has a unit for the frame rate, else seconds. Tangents are linear.
    """
    rig, unit = animation.rig, TIME_UNITS.get(animation.fps, "sec")
    if unit == "sec":
        times = [f"{number / animation.fps:.9g}" for number in animation.frame_numbers.tolist()]
    else:
        times = [str(number) for number in animation.frame_numbers.tolist()]
    lines = ["animVersion 1.1;", "mayaVersion 2020;", f"timeUnit {unit};", "linearUnit mm;", "angularUnit deg;"]
    lines += [f"startTime {times[0]};", f"endTime {times[-1]};"]
    columns = digits(animation.controls.detach().cpu().numpy().T)
    every = range(len(times))
    for number, (control, values) in enumerate(zip(rig.controls, columns)):
        rows = every if animation.keys is None else animation.keys[number].tolist()
        name = legal(control.name)
        lines += _curve(name, name, f"{legal(rig.name)}_controls", number, OUTPUTS.get(control.unit, "unitless"))
        lines += _keys(times, values, rows)
    motion = rigid_motion_columns(animation)
    if motion is not None:
        for number, (name, values) in enumerate(zip(MOTION, digits(np.ascontiguousarray(motion.T)))):
            full = f"{name[:-1]}.{name}"
            output = "angular" if name.startswith("rotate") else "linear"
            lines += [*_curve(full, name, f"{legal(rig.name)}_motion", number, output), *_keys(times, values, every)]
    write_text(path, "\n".join(lines) + "\n")


def legal(name: str) -> str:
    """A name with the characters that Maya allows."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"_{plain}" if plain[:1].isdigit() or not plain else plain


def _curve(full: str, leaf: str, node: str, number: int, output: str) -> list[str]:
    head = [f"anim {full} {leaf} {node} 0 0 {number};", "animData {", "  input time;", f"  output {output};", "  weighted 0;"]
    return [*head, "  preInfinity constant;", "  postInfinity constant;", "  keys {"]


def _keys(times: list[str], values: list[str], rows: range | list[int]) -> list[str]:
    return [*(f"    {times[row]} {values[row]} linear linear 1 1 0;" for row in rows), "  }", "}"]
