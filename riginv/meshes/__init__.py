"""Meshes in files: polygons, OBJ and PLY, as they stand, with their vertices in the file's order."""
