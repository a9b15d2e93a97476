"""python -m rigs.blender.export: a default rig as a .blend that an animator can open and pose."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "export_blender")  # before the imports that take seconds

from dataclasses import dataclass

from omegaconf import DictConfig

from riginv.config.building import ClassSpec
from riginv.config.typed import to_typed
from riginv.rig.interface import RigBackend
from riginv.runs.console import show_result
from riginv.runs.files import free_file
from rigs.blender.interpreter import find_interpreter
from rigs.blender.twin import blueprint_of, write_blend


@dataclass(frozen=True)
class ExportConfig:
    """The config of `rigs.blender.export`; conf/export_blender.yaml explains each key."""

    rig: ClassSpec[RigBackend]
    out: str
    interpreter: str | None


def export(config: DictConfig) -> None:
    """Write `config.rig` to `config.out`."""
    settings = to_typed(config, ExportConfig)
    out = free_file(settings.out, ".blend")
    interpreter = find_interpreter(settings.interpreter, "interpreter")
    rig = settings.rig.build()
    blueprint = blueprint_of(rig)
    write_blend(blueprint, out, interpreter)
    show_result(
        f"{out}: rig '{rig.name}', {len(blueprint.controls)} controls on the object '{rig.name} controls', "
        f"{len(blueprint.shapes)} shape keys on '{rig.name}', {out.stat().st_size / 1e6:.1f} MB"
    )


if __name__ == "__main__":
    command("export_blender")(export)()
