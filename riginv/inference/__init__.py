"""Trained models as files, and ready for use."""
