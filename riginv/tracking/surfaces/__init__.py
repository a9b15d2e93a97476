"""Inversion of scans of any topology, by distances between surfaces."""
