"""python -m rigs.dna.export: a rig as a DNA file, read back and compared before it is left there."""

import tempfile
from pathlib import Path

import torch
from omegaconf import DictConfig
from rich.console import Console

from riginv.config.building import build
from riginv.config.validation import validate
from riginv.errors import InputError
from riginv.launch.command import command
from riginv.rig.contract import random_controls
from riginv.rig.interface import RigBackend
from riginv.runs.run_folder import plain_config
from rigs.dna.draft import Draft
from rigs.dna.exports import draft_of
from rigs.dna.format import write_dna
from rigs.dna.rig import DnaRig

POSES = 8  # random poses in which the two rigs are compared, beside rest and limits
AGREES_MM = 1e-2
MOST = 65_535  # of anything that the format counts in 16 bits


def export(config: DictConfig) -> None:
    """Write `config.rig` to `config.out`."""
    plain = plain_config(config)
    validate(plain)
    out = Path(str(plain["out"]))
    if out.suffix.lower() != ".dna" or out.is_dir():
        raise InputError(f"out={out}: expected the name of a file that ends in .dna")
    rig = build(plain["rig"], kind=RigBackend)
    draft = draft_of(rig)
    apart = write_rig(rig, draft, out)
    Console().print(
        f"{out}: rig '{rig.name}', {len(draft.gui)} GUI controls, {len(draft.raw)} raw controls, {len(draft.psds)} PSDs, "
        f"{len(draft.channels)} blendshape channels, {len(draft.joints)} joints, {out.stat().st_size / 1e6:.1f} MB; read back, "
        f"its meshes differ by {apart:.2g} mm at most",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


def write_rig(rig: RigBackend, draft: Draft, out: Path) -> float:
    """Write a draft of a rig, where what is read back agrees with the rig; how far the two are apart, mm.

    Raises:
        InputError: the format cannot count so many, or the two differ.
    """
    counts = {"GUI controls": draft.gui, "raw controls and PSDs": [*draft.raw, *draft.psds], "rows of the table": draft.rows}
    counts |= {"channels": draft.channels, "joint attributes (nine a joint)": 9 * draft.joints}
    for what, things in counts.items():
        if len(things) > MOST:
            raise InputError(f"rig '{rig.name}': {len(things):,} {what}, where a DNA file holds at most {MOST:,}")
    file = draft.file()
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent) as folder:
        tried = Path(folder) / out.name
        write_dna(tried, file)
        apart = largest_difference(rig, DnaRig(str(tried), controls="gui", unit_mm=10.0))
    if not apart <= AGREES_MM:
        raise InputError(
            f"rig '{rig.name}': as a DNA file it differs by {apart:.3g} mm, expected {AGREES_MM:g} at most: its logic is not "
            f"what its draft says"
        )
    write_dna(out, file)
    return apart


@torch.no_grad()
def largest_difference(rig: RigBackend, other: DnaRig) -> float:
    """How far vertices of two rigs are apart at most, mm, at rest, at limits and in random poses."""
    if len(rig.rest_vertices) != len(other.rest_vertices):
        raise InputError(f"rig '{rig.name}': {len(rig.rest_vertices)} vertices, read back {len(other.rest_vertices)}")
    index_of = {name: number for number, name in enumerate(rig.control_names)}
    missing = [name for name in other.control_names if name not in index_of]
    if missing:
        raise InputError(f"rig '{rig.name}' has no control '{missing[0]}', which its draft has")
    order = [index_of[name] for name in other.control_names]
    controls = torch.cat([rig.neutral_controls[None], rig.lower[None], rig.upper[None], random_controls(rig, POSES, 0)])
    apart = [(rig(one[None]) - other(one[None, order])).norm(dim=2).max() for one in controls]
    return float(torch.stack(apart).max())


if __name__ == "__main__":
    command("export_dna")(export)()
