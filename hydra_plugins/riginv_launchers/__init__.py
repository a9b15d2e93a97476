"""Launchers for the jobs of a sweep; Hydra discovers them by the name of the parent folder."""
