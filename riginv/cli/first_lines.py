"""What a command says first: what was read, how large the rig is, and what of it can hardly be meant."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from riginv.rig import RigBackend
from riginv.rig_size import rig_line, size_doubt


def show_rig(rig: RigBackend, config: Mapping[str, Any] | None = None, console: Console | None = None) -> None:
    """Say what a rig is and how large, and doubt a size that can hardly be.

    Args:
        config: what built it.
        console: where; None: standard error.
    """
    doubt = size_doubt(rig, (config or {}).get("unit_mm"))
    show_lines([rig_line(rig)], getattr(rig, "notes", ()), [doubt] if doubt else [], console)


def show_lines(
    lines: Sequence[str], notes: Sequence[str] = (), warnings: Sequence[str] = (), console: Console | None = None
) -> None:
    """Print lines, notes and warnings, each in a line of its own; to standard error, where no console is named."""
    console = console or Console(stderr=True)
    for start, texts, style in (("", lines, ""), ("note: ", notes, ""), ("warning: ", warnings, "yellow")):
        for text in texts:
            console.print(Text.assemble((start, style), text), highlight=False, soft_wrap=True)
