"""Evaluation by the true rig."""
