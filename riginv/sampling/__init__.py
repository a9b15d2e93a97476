"""What networks train on: controls, and meshes in mesh coordinates, drawn as training goes."""
