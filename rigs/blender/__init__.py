"""Blender: .blend files as rigs, evaluated by worker processes, and export of rigs as .blend files."""
