"""A body on CC0 geometry: linear blend skinning, 77 joints with all fingers, controls in degrees and millimetres."""

from rigs.body.rig import BodyRig as BodyRig
