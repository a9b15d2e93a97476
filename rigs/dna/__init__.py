"""DNA files as rigs: read, evaluated, inverted, written (docs/dna.md)."""

from rigs.dna.rig import DnaRig as DnaRig
