"""From a clip of meshes to controls over time."""
