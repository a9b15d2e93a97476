"""Compiled CPU kernels behind the functions of this package and of the solvers."""
