"""python -m rigs.blender.export: a default rig as a .blend that an animator can open and move."""

from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from riginv.config.building import build
from riginv.config.validation import validate
from riginv.errors import InputError
from riginv.launch.command import command
from riginv.rig.interface import RigBackend
from riginv.runs.run_folder import plain_config
from rigs.blender.interpreter import find_interpreter
from rigs.blender.twin import blueprint_of, write_blend


def export(config: DictConfig) -> None:
    """Write `config.rig` to `config.out`."""
    plain = plain_config(config)
    validate(plain)
    out = Path(plain["out"])
    if out.suffix.lower() != ".blend":
        raise InputError(f"out={out}: expected the name of a file that ends in .blend")
    interpreter = find_interpreter(plain["interpreter"])
    rig = build(plain["rig"], kind=RigBackend)
    blueprint = blueprint_of(rig)
    write_blend(blueprint, out, interpreter)
    Console().print(
        f"{out}: rig '{rig.name}', {len(blueprint.controls)} controls on the object '{rig.name} controls', "
        f"{len(blueprint.shapes)} shape keys on '{rig.name}', {out.stat().st_size / 1e6:.1f} MB",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


if __name__ == "__main__":
    command("export_blender")(export)()
