"""Lattice planner: the cheapest of many polynomials in the Frenet frame of the route's reference line.

    candidates     settings; ego and others on the plan's time grid; which polynomials are tried, what each pair costs
    checks         quintics and quartics, the states that they stand for; speed, curvature, road, everybody else
    planner        the cheapest pair that passes, or the fallback; what a recording shows

Source: Werling, Ziegler, Kammel, Thrun, "Optimal Trajectory Generation for Dynamic Street Scenarios in a Frenet Frame",
ICRA 2010.
"""

from planners.lattice.candidates import LatticeConfig
from planners.lattice.planner import Lattice

__all__ = ["Lattice", "LatticeConfig"]
