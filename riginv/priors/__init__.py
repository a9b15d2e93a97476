"""What is known of a rig's controls before anything is measured: mean and covariance, learned or derived from their names."""
