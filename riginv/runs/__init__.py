"""What a run keeps on disk: folders, whole files, locks, checksums."""
