"""Compiled CPU kernels for what thousands of small tensor operations would do; pure PyTorch stands in where there are none."""
