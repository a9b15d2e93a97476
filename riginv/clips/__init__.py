"""Captured and simulated performances as mesh clips."""
