"""USD stages, read in a process of their own: a damaged one can bring the library down that reads it."""
