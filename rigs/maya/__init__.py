"""Scripts for Maya's Python."""
