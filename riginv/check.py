"""python -m riginv.check: check a rig against the contract."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "check")  # before the imports that take seconds

import sys
from dataclasses import dataclass

from omegaconf import DictConfig
from rich.console import Console
from rich.markup import escape

from riginv.config.building import ClassSpec
from riginv.config.typed import to_typed
from riginv.config.values import NonNegativeInt
from riginv.rig.contract import ContractError, contract
from riginv.rig.interface import RigBackend
from riginv.rig.size import show_rig


@dataclass(frozen=True)
class CheckConfig:
    """The config of `riginv.check`; conf/check.yaml explains each key."""

    rig: ClassSpec[RigBackend]
    seed: NonNegativeInt


def check(config: DictConfig) -> None:
    """Go through the contract clause by clause, and exit with 1 where one does not hold."""
    settings = to_typed(config, CheckConfig)
    rig = settings.rig.build()
    console, broken = Console(), 0
    show_rig(rig, settings.rig.config, console)
    for clause, holds in contract(rig, settings.seed):
        try:
            holds()
            console.print(f"  [green]holds[/]   {clause}")
        except ContractError as error:
            broken += 1
            console.print(f"  [red]broken[/]  {clause}\n          {escape(str(error))}", highlight=False)
    if broken:
        sys.exit(1)
    console.print(
        "The rig fulfils the contract. Next, with the same rig arguments: riginv contact_sheet, invert or train.",
        soft_wrap=True,
    )


if __name__ == "__main__":
    command("check")(check)()
