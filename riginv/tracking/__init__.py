"""Inversion of clips: meshes or scans to controls over time."""
