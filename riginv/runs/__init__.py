"""Runs: folders, atomic files, locks, checksums, cache, tables, threads, worker processes."""
