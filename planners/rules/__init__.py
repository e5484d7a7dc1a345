"""Traffic rules for every planner: where the ego must stop now, and for what.

    zones      what stands along a reference path: stop lines, crosswalks, lanes that go first; when others take these
    rulebook   the demands at one frame, and what is remembered of them

Give a `Rulebook` the reference path, and each frame its scene; it answers with the stops ahead, as occupancy, and with
what it must be given next time. Where a road has no rules it answers at once. It uses the present colours and the
predictions of the frame, nothing of the future.

Sources: lights and stop signs as everywhere (StVO 37, 41 sign 206; Vienna Convention on Road Signs, art. 23). The
ego stops at a yellow where it comfortably can (ITE, "Determining Vehicle Signal Change and Clearance Intervals":
3.05 m/s2). Crosswalks: who is on one or evidently wants to cross goes first (StVO 26, UN Vienna Convention art. 21).
Right of way: StVO 8; no stop where lanes cross (StVO 11 (1)) or on a crosswalk (StVO 26 (2)).
"""

from planners.rules.rulebook import Rulebook, RuleMemory, RulesConfig

__all__ = ["RuleMemory", "Rulebook", "RulesConfig"]
