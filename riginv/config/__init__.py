"""From configs to objects, and from mistakes in them to sentences."""
