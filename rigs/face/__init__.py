"""The default rig: a face of 137 controls, 628 blendshape weights and 8,447 vertices on CC0 geometry."""

from rigs.face.rig import FaceRig as FaceRig
