"""A cube as a rig."""
