"""Folders of sculpted shapes as rigs (docs/shapes.md)."""

from rigs.shapes.rig import ShapesRig as ShapesRig
