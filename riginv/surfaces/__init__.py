"""Surfaces that are not the rig's own mesh: closest points, scans matched to a rig, a mesh wrapped onto a scan."""
