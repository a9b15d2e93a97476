"""Shapes that a rig lacks: the residual of a clip as products of controls times sparse shapes."""
