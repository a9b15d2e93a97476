"""Actors whose face at rest differs from the rig."""
