"""Controls over time, and the files that hold them."""
