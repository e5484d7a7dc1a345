"""The planner of this repository."""
