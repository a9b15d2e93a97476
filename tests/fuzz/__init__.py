"""Seeded mutation of every file that riginv reads: `python -m tests.fuzz` prints the tally (docs/reliability.md)."""
