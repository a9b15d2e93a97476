"""Readers of clips: sequences of meshes, captured or simulated."""
