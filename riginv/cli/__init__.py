"""What the command lines share: configs, run folders, tables, and plain words for mistakes."""
