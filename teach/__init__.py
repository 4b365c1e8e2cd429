"""Sketches become a distribution of 3D trajectories."""
