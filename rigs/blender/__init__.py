"""Blender as a rig and as a judge: rigs exported as .blend files, and .blend files evaluated by worker processes."""
