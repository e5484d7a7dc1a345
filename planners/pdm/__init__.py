"""PDM-Closed: drivers in several tracks are proposed, simulated, scored; the best proposal is driven.

    proposals   an IDM driver per track and share of the speed limit, and how a car with a tracker follows each of them
    score       what nuPlan's closed-loop metrics say of each simulated proposal
    planner     the planner's one screen, its settings, and what a recording shows

Source: Dauner, Hallgarten, Geiger, Chitta, "Parting with Misconceptions about Learning-based Vehicle Motion Planning",
CoRL 2023 (arXiv 2306.07962); numbers of its code, autonomousvision/tuplan_garage. What differs: docs/peers.md.
"""

from planners.pdm.planner import Pdm, PdmConfig

__all__ = ["Pdm", "PdmConfig"]
