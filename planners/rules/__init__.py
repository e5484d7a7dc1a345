"""Traffic rules for every planner: where the ego must stop now, and for what.

    zones      stop lines, crosswalks and priority lanes along a reference path, and when other road
               users take them
    rulebook   the stops that the rules demand at one frame, and the memory of them

A `Rulebook` is built for a reference path. For the scene of each frame and its memory it returns
the stops ahead, as occupancy, and the memory for the next frame. Where a road has no rules it
returns at once. It uses the present colours and the predictions of the frame, and no later data.

Sources: lights and stop signs as everywhere (StVO 37, 41 sign 206; Vienna Convention on Road Signs,
art. 23). The ego stops at a yellow where it comfortably can (ITE, "Determining Vehicle Signal
Change and Clearance Intervals": 3.05 m/s2). Crosswalks: those on one or who evidently want to cross
go first (StVO 26, UN Vienna Convention art. 21). Right of way: StVO 8; no stop where lanes cross
(StVO 11 (1)) or on a crosswalk (StVO 26 (2)).
"""

from replan.planners.rules.rulebook import Rulebook, RuleMemory, RulesConfig

__all__ = ["RuleMemory", "Rulebook", "RulesConfig"]
