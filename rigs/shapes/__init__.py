"""A folder of sculpted shapes as a rig (docs/shapes.md)."""

from rigs.shapes.rig import ShapesRig as ShapesRig
