"""python -m studio_face.convert shapes.npz logic.json animation.npz out=DIR: Aura's files as a folder of shapes and controls.

Writes into DIR, which must not exist: neutral.obj and deltas.npz (cm) with controls.json, the face; and in takes/ the animation
as curves of the shapes' controls (shapes.npz) and of the animator's (animator.npz).
"""

import sys
from pathlib import Path

import numpy as np

from riginv.errors import InputError
from riginv.meshes.obj import obj_text
from riginv.runs.files import atomic_write, read_json, write_json, write_text

FPS = 30.0  # assumed: the animation does not say


def convert(shapes: Path, logic: Path, animation: Path, out: Path) -> None:
    """Write the folder; all or nothing."""
    if out.exists():
        raise InputError(f"out={out} exists already: give the name of a new folder")
    facts = read_json(logic)
    with np.load(shapes, allow_pickle=False) as arrays, np.load(animation, allow_pickle=False) as frames:
        rest, quads = arrays["rest"], arrays["quads"]
        points = np.c_[rest, np.ones(len(rest))]
        deltas = np.einsum("vb,kibj,vj->kvi", arrays["weights"], arrays["transforms"], points, optimize=True)
        curves = {"shapes": frames["controls"], "animator": frames["animator_controls"]}
    with atomic_write(out) as folder:
        (folder / "takes").mkdir(parents=True)
        write_text(folder / "neutral.obj", obj_text(rest, quads, header="", digits=".6f"))
        names = [shape["name"] for shape in facts["aura_shapes"]]
        np.savez(folder / "deltas.npz", **dict(zip(names, deltas.astype(np.float32))))
        table = {control_name(control): sides(control) for control in facts["animator_controls"]}
        write_json(folder / "controls.json", table)
        lowest = {"shapes": 0.0, "animator": [-1.0 if "negative" in found else 0.0 for found in table.values()]}
        for kind, labels in (("shapes", facts["controls"]), ("animator", list(table))):
            values = np.clip(curves[kind].astype(np.float32), lowest[kind], 1.0).astype(np.float32)
            np.savez(folder / f"takes/{kind}.npz", controls=values, names=np.array(labels), fps=FPS)


def control_name(control: dict[str, str]) -> str:
    """Without the slash, which file names and scene paths cannot hold."""
    return control["name"].replace("/", "_")


def sides(control: dict[str, str | None]) -> dict[str, str]:
    """The shape on each side that has one."""
    return {side: control[side] for side in ("positive", "negative") if control[side]}


if __name__ == "__main__":
    *files, out = sys.argv[1:] or [""]
    if len(files) != 3 or not out.startswith("out="):
        sys.exit("usage: python -m studio_face.convert shapes.npz logic.json animation.npz out=DIR")
    try:
        convert(*map(Path, files), Path(out.removeprefix("out=")))
    except (InputError, OSError, KeyError, ValueError) as error:
        sys.exit(f"studio_face.convert: {error}")
