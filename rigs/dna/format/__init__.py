"""The DNA file format: reading and writing of layers, byte for byte, without evaluation."""

from rigs.dna.format.container import DnaFile, Layer, read_dna, write_dna

__all__ = ["DnaFile", "Layer", "read_dna", "write_dna"]
