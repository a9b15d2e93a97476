"""Optimisation in mesh coordinates: what a rig can do at best, mesh by mesh or for a whole clip."""
