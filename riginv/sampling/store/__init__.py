"""Stores of sampled poses: zarr groups that many processes fill chunk by chunk, and that training reads in windows."""
