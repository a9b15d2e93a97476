"""DNA files as they are: layers read, kept and written back byte for byte; nothing here evaluates them."""

from rigs.dna.format.container import DnaFile, Layer, read_dna, write_dna

__all__ = ["DnaFile", "Layer", "read_dna", "write_dna"]
