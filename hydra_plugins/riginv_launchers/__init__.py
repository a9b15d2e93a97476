"""Where the jobs of a sweep run: launchers for Hydra, which finds them by the name of the folder above."""
