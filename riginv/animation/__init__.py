"""Animation curves: controls over time, and the file formats they are written in."""
