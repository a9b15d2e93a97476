"""Optimisation of controls in mesh coordinates, mesh by mesh or for a whole clip."""
