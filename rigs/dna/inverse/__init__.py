"""Exact inverse of a file's GUI table: from raw controls to GUI controls within their limits."""

from rigs.dna.inverse.table import TableInverse as TableInverse
