"""PDM-Closed: IDM drivers in several tracks are proposed, simulated and scored; the best one is driven."""

from planners.pdm.planner import Pdm, PdmConfig

__all__ = ["Pdm", "PdmConfig"]
