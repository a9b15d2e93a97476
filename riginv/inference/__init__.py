"""Inference: bundles, which hold trained models, and the inverse that is loaded from one."""
