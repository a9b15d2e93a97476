"""Scans of any topology, matched by the surface of the rig."""
