"""Training: Lightning modules, losses, data, callbacks, several devices."""
