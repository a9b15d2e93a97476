"""Rigs: the interface, its contract, black-box and recorded rigs, and mesh space."""
