"""USD stages as clips, read in a worker process, since damaged files can crash the library."""
