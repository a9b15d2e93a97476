"""Meshes: polygons, OBJ and PLY files with their vertex order kept, metrics, rendering."""
