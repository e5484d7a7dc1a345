"""Lattice planner: the cheapest of many polynomials in the Frenet frame of the route's reference line.

    planner        settings; the polynomials that are tried; the cheapest pair that passes, or the fallback
    candidates     their coefficients and states; what a pair costs; speed, curvature, road, other agents

Source: Werling, Ziegler, Kammel, Thrun, "Optimal Trajectory Generation for Dynamic Street Scenarios in a Frenet Frame",
ICRA 2010.
"""

from planners.lattice.planner import Lattice, LatticeConfig

__all__ = ["Lattice", "LatticeConfig"]
