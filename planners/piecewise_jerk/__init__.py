"""Piecewise-jerk QPs, over station and over time: problem, own interior-point solver, and the door to all solvers."""
