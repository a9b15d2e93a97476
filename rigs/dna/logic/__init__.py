"""The logic of DNA files: from GUI controls to raw controls, joints, blendshape channels and animated maps."""

from rigs.dna.logic.stages import Logic as Logic
