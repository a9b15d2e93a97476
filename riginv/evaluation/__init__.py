"""Evaluation on the true rig: evaluation sets, results, the optimum."""
