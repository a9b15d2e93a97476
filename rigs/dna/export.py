"""python -m rigs.dna.export: write a rig as a DNA file, which is read back and compared first."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "export_dna")  # before the imports that take seconds

import tempfile
from dataclasses import dataclass
from pathlib import Path

import torch
from omegaconf import DictConfig

from riginv.config.building import ClassSpec
from riginv.config.typed import to_typed
from riginv.errors import InputError
from riginv.rig.contract import random_controls
from riginv.rig.interface import RigBackend
from riginv.runs.console import show_result
from riginv.runs.files import free_file
from rigs.dna.draft import Draft
from rigs.dna.exports import draft_of
from rigs.dna.format import write_dna
from rigs.dna.rig import DnaRig

POSES = 8  # random poses in which the two rigs are compared, beside rest and limits
TOLERANCE_MM = 1e-2
MOST = 65_535  # 16-bit counts of the format


@dataclass(frozen=True)
class ExportConfig:
    """The config of `rigs.dna.export`."""

    rig: ClassSpec[RigBackend]
    out: str


def export(config: DictConfig) -> None:
    """Write `config.rig` to `config.out`."""
    settings = to_typed(config, ExportConfig)
    out = free_file(settings.out, ".dna")
    rig = settings.rig.build()
    draft = draft_of(rig)
    difference = write_rig(rig, draft, out)
    show_result(
        f"{out}: rig '{rig.name}', {len(draft.gui)} GUI controls, {len(draft.raw)} raw controls, {len(draft.psds)} PSDs, "
        f"{len(draft.channels)} blendshape channels, {len(draft.joints)} joints, {out.stat().st_size / 1e6:.1f} MB; read back, "
        f"its meshes differ by {difference:.2g} mm at most"
    )


def write_rig(rig: RigBackend, draft: Draft, out: Path) -> float:
    """Write the draft of a rig after reading it back and comparing the two.

    Returns:
        Greatest vertex distance between the rig and the file, mm.

    Raises:
        InputError: a count exceeds the format's limit, or the two differ.
    """
    counts = {"GUI controls": len(draft.gui), "raw controls and PSDs": len(draft.raw) + len(draft.psds)}
    counts |= {"rows of the table": len(draft.rows), "channels": len(draft.channels)}
    counts["joint attributes (nine a joint)"] = 9 * len(draft.joints)
    for what, count in counts.items():
        if count > MOST:
            raise InputError(f"rig '{rig.name}': {count:,} {what}, where a DNA file holds at most {MOST:,}")
    file = draft.file()
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent) as folder:
        trial = Path(folder) / out.name
        write_dna(trial, file)
        difference = largest_difference(rig, DnaRig(str(trial), controls="gui", unit_mm=10.0))
    if not difference <= TOLERANCE_MM:
        raise InputError(
            f"rig '{rig.name}': as a DNA file it differs by {difference:.3g} mm, expected {TOLERANCE_MM:g} at most: its "
            f"logic differs from its draft"
        )
    write_dna(out, file)
    return difference


@torch.no_grad()
def largest_difference(rig: RigBackend, other: DnaRig) -> float:
    """Greatest vertex distance between two rigs, mm, at rest, at limits and in random poses."""
    if len(rig.rest_vertices) != len(other.rest_vertices):
        raise InputError(f"rig '{rig.name}': {len(rig.rest_vertices)} vertices, read back {len(other.rest_vertices)}")
    index_of = {name: number for number, name in enumerate(rig.control_names)}
    missing = [name for name in other.control_names if name not in index_of]
    if missing:
        raise InputError(f"rig '{rig.name}' has no control '{missing[0]}', which its draft has")
    order = [index_of[name] for name in other.control_names]
    controls = torch.cat([rig.neutral_controls[None], rig.lower[None], rig.upper[None], random_controls(rig, POSES, 0)])
    distances = [(rig(pose[None]) - other(pose[None, order])).norm(dim=2).max() for pose in controls]
    return float(torch.stack(distances).max())


if __name__ == "__main__":
    command("export_dna")(export)()
