"""Piecewise-jerk QPs, over station and over time: problem, interior-point solver, interface to all
solvers.
"""
