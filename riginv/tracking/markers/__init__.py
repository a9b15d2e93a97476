"""Inversion of a few dozen markers on a rig's surface."""
