"""What a DNA file computes: from GUI controls to raw controls, and on to joints, blendshape channels and animated maps."""

from rigs.dna.logic.stages import Logic, Stages

__all__ = ["Logic", "Stages"]
