"""Training: from a config to a network."""
