"""Commands, sweeps and the processes that they start."""
