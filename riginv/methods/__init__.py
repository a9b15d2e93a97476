"""Methods of rig inversion behind one interface, for `python -m riginv.compare`."""
