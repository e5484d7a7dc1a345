"""Piecewise-jerk QPs, over station and over time: problem, own interior-point solver, interface to all solvers."""
