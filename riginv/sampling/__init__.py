"""Samplers of training data: random controls, and random meshes in mesh coordinates."""
