"""From raw controls back to GUI controls: the exact inverse of a file's table within the limits of its GUI controls."""

from rigs.dna.inverse.table import GuiAnswer, TableInverse

__all__ = ["GuiAnswer", "TableInverse"]
