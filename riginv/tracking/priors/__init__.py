"""Priors on controls, learned from takes or from generated performances."""
