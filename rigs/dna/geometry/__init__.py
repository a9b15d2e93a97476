"""The geometry of DNA files in millimetres: joints, meshes, blendshape targets, skin weights."""
