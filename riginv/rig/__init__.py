"""Rigs: their interface, those known by meshes alone, and the mesh space that everything is trained in."""
