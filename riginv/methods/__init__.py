"""Ways of inverting a rig, all behind one interface, so that `python -m riginv.compare` can put them side by side."""
