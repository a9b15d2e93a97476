"""Faults, injected for real: whatever dies on the way, nothing is lost (docs/reliability.md)."""
