"""A folder of rigs for benchmarks/other_rigs.py, made from what riginv itself holds.

    python -m benchmarks.rig_list FOLDER [--take take.csv] [--aura DIR] [--dna DIR]

Without options nothing outside the repository is needed. `--take` is a Live Link Face recording; `--aura` the folder of Meta's
Aura (Apache-2.0: shapes.npz, animation.npz, logic.json), of which nothing is kept in riginv; `--dna` a folder of DNA files.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from benchmarks.aura_rig import write_aura
from benchmarks.dna_head import make_head
from riginv.meshes.obj import obj_text
from riginv.rig.arkit import ARKIT_NAMES
from riginv.rig.contract import random_controls
from riginv.rig.pairs import write_pairs
from riginv.runs.files import write_text
from rigs.dna.export import write_rig
from rigs.dna.exports import draft_of
from rigs.dna.format import write_dna
from rigs.face import FaceRig
from rigs.gltf import GltfRig
from rigs.shapes import ShapesRig
from tests.support.creatures import CREATURES, write_creature

OURS, CC0 = "MIT (riginv)", "MIT (riginv); shapes from CC0 assets"
CUBE = Path(__file__).parent.parent / "examples/cube_rig"
POSES = 4000  # recorded of the cube
HEAD = {"raws": 250, "psds": 600, "joints": 800, "channels": 800, "rows": 160, "columns": 150}
Entries = Iterator[tuple[str, dict[str, Any]]]


def entry(about: str, licence: str, *overrides: str, **takes: str) -> dict[str, Any]:
    """A rig as the list holds it; a take is a file."""
    chosen = {name: [f"capture={file}"] for name, file in takes.items() if file}
    return {"about": about, "licence": licence, "overrides": list(overrides), "takes": chosen}


def faces(folder: Path, takes: dict[str, str]) -> Entries:
    """The default face; its 52 ARKit shapes alone as a folder of shapes, and that folder as a DNA file."""
    yield "face", entry("the default face", CC0, "rig=face", **takes)
    face, out = FaceRig(), folder / "arkit"
    deltas = face.arkit_deltas()
    write_text(out / "neutral.obj", obj_text(face.rest_vertices.numpy(), face.faces.numpy()))
    np.savez(out / "deltas.npz", **{name: deltas[name].numpy() for name in ARKIT_NAMES if name in deltas})
    yield "arkit", entry("its 52 ARKit shapes alone, no correctives", CC0, "rig=shapes", "rig.folder=arkit", **takes)
    shapes = ShapesRig(str(out))
    write_rig(shapes, draft_of(shapes), folder / "arkit.dna")
    yield "arkit_dna", entry("the same as a DNA file", CC0, "rig=dna", "rig.file=arkit.dna", "rig.unit_mm=10", **takes)


def skeletons(folder: Path) -> Entries:
    """The default body, creatures of tubes with an animation each, and one of them as a DNA file."""
    yield "body", entry("the default body", CC0, "rig=body")
    for name, make in CREATURES.items():
        file = write_creature(folder / f"{name}.glb", make()).name
        yield name, entry(make.__doc__ or "", OURS, "rig=gltf", f"rig.file={file}", "rig.joints=true", gait=file)
    options = {"joints": True, "joint_translation": False, "joint_scale": False, "joint_limit_deg": 60.0}
    write_rig(fox := GltfRig(str(folder / "fox.glb"), **options), draft_of(fox), folder / "fox.dna")
    yield "fox_dna", entry("the fox as a DNA file", OURS, "rig=dna", "rig.file=fox.dna", "rig.unit_mm=10")


@torch.no_grad()
def others(folder: Path) -> Entries:
    """A cube that is known by recorded poses alone, and a DNA head of production size."""
    sys.path.insert(0, str(CUBE))
    from cube_rig.cube import CubeRig

    cube = CubeRig(100.0)
    controls = random_controls(cube, POSES, 0)
    arrays = {"controls": controls, "vertices": cube(controls), "rest_vertices": cube.rest_vertices, "faces": cube.faces}
    arrays |= {"lower": cube.lower, "upper": cube.upper, "neutral": cube.neutral_controls}
    numbers = {name: values.numpy() for name, values in arrays.items()}
    write_pairs(folder / "cube.npz", {**numbers, "control_names": np.array(cube.control_names)})
    yield "cube_pairs", entry(f"{POSES:,} recorded poses of examples/cube_rig", OURS, "rig=pairs", "rig.file=cube.npz")
    write_dna(folder / "production.dna", make_head(**HEAD).file())
    about = "random numbers in the sizes of a production head (benchmarks/dna_head.py)"
    yield "production_dna", entry(about, OURS, "rig=dna", "rig.file=production.dna")


def dna_files(folder: Path) -> Entries:
    """DNA files, where they lie."""
    for file in sorted(folder.resolve().glob("*.dna")):
        yield file.stem, entry(f"the DNA file {file.name}", "as given", "rig=dna", f"rig.file={file}")


def main() -> None:
    """Write the folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    for name, what in (("take", "a Live Link Face recording"), ("aura", "a folder"), ("dna", "a folder")):
        parser.add_argument(f"--{name}", type=Path, help=what)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    takes = {"take": str(given.take.resolve())} if given.take else {}
    rigs = {}
    if given.aura:
        overrides = ["rig=shapes", "rig.folder=aura", "rig.unit_mm=10"]
        aura = write_aura(given.aura, given.folder, given.take)
        takes["aura"] = aura.as_recording
        about = "a production head with its own animation (Meta's Aura)"
        rigs["aura"] = entry(about, "Apache-2.0 (Meta)", *overrides, own=aura.animation, take=aura.take)
    for entries in (faces(given.folder, takes), skeletons(given.folder), others(given.folder)):
        rigs |= dict(entries)
    rigs |= dict(dna_files(given.dna)) if given.dna else {}
    write_text(given.folder / "rigs.yaml", yaml.safe_dump(rigs, sort_keys=False, width=160))


if __name__ == "__main__":
    main()
