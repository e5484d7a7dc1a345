"""Lattice planner: the cheapest of many polynomials in the Frenet frame of the route's reference line.

    config         settings
    polynomials    quintics and quartics, and the states that they stand for
    scene          ego and others on the plan's time grid, in the Frenet frame
    candidates     which polynomials are tried, and what each pair costs
    checks         speed, acceleration, curvature, road, everybody else
    record         what a recording shows
    planner        the cheapest pair that passes, or the fallback

Source: Werling, Ziegler, Kammel, Thrun, "Optimal Trajectory Generation for Dynamic Street Scenarios in a Frenet Frame",
ICRA 2010.
"""

from planners.lattice.config import LatticeConfig
from planners.lattice.planner import Lattice

__all__ = ["Lattice", "LatticeConfig"]
