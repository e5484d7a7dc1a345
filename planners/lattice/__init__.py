"""Lattice planner: the cheapest of many polynomials in the Frenet frame of the route's reference
line.

    planner        settings; the polynomials to try; the cheapest feasible pair, or the fallback
    candidates     coefficients and states of polynomials; cost of a pair; checks of speed,
                   curvature, road, agents

Source: Werling, Ziegler, Kammel, Thrun, "Optimal Trajectory Generation for Dynamic Street Scenarios
in a Frenet Frame", ICRA 2010.
"""

from replan.planners.lattice.planner import Lattice, LatticeConfig

__all__ = ["Lattice", "LatticeConfig"]
