"""PDM-Closed: it proposes, simulates and scores IDM drivers on several tracks, and drives the best
one.
"""

from replan.planners.pdm.planner import Pdm, PdmConfig

__all__ = ["Pdm", "PdmConfig"]
