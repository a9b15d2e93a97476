"""python -m rigs.dna.copy: read a DNA file and write it again, as a check that nothing is lost."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "copy_dna")  # before the imports that take seconds

from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig

from riginv.config.typed import to_typed
from riginv.runs.console import show_result
from riginv.runs.files import free_file
from rigs.dna.format import read_dna, write_dna


@dataclass(frozen=True)
class CopyConfig:
    """The config of `rigs.dna.copy`."""

    file: str
    out: str


def copy(config: DictConfig) -> None:
    """Write `config.file` to `config.out`."""
    settings = to_typed(config, CopyConfig)
    source, out = Path(settings.file), free_file(settings.out, ".dna")
    file = read_dna(source)
    write_dna(out, file)
    layers = " ".join(f"{layer.name}@{layer.version[0]}.{layer.version[1]}" for layer in file.layers)
    equal = out.read_bytes() == source.read_bytes()
    comparison = (
        "equal to" if equal else f"not equal to ({file.unused_bytes:,} bytes of it belong to no layer, or its layers lie apart)"
    )
    show_result(f"{out}: DNA 2.{file.version}, {out.stat().st_size:,} bytes, {comparison} {source}; layers {layers}")


if __name__ == "__main__":
    command("copy_dna")(copy)()
