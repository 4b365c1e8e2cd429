"""A distribution of trajectories becomes a checked plan and a motion."""
