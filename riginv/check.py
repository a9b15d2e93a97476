"""python -m riginv.check: does a rig keep the contract?"""

import sys

from omegaconf import DictConfig
from rich.console import Console
from rich.markup import escape

from riginv.config.building import build
from riginv.config.validation import validate
from riginv.launch.command import command
from riginv.rig.contract import ContractError, contract
from riginv.rig.interface import RigBackend
from riginv.rig.size import show_rig
from riginv.runs.run_folder import plain_config


def check(config: DictConfig) -> None:
    """Go through the contract clause by clause, and exit with 1 where one does not hold."""
    plain = plain_config(config)
    validate(plain)
    rig = build(plain["rig"], kind=RigBackend)
    console, broken = Console(), 0
    show_rig(rig, plain["rig"], console)
    for clause, holds in contract(rig, plain["seed"]):
        try:
            holds()
            console.print(f"  [green]holds[/]   {clause}")
        except ContractError as error:
            broken += 1
            console.print(f"  [red]broken[/]  {clause}\n          {escape(str(error))}", highlight=False)
    if broken:
        sys.exit(1)


if __name__ == "__main__":
    command("check")(check)()
