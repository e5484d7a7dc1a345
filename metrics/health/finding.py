"""One thing that is wrong with a log."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Kind(Enum):
    """What can be wrong; `EFFECT` says what it does to which metric."""

    PHANTOM = "phantom"
    EGO_GAP = "ego gap"
    EGO_JUMP = "ego jump"
    EGO_SPEED = "ego speed"
    EGO_HEADING = "ego heading"
    AGENT_GAP = "flickering"
    ID_SWITCH = "id switch"
    TELEPORT = "teleport"
    AGENT_SPEED = "agent speed"
    HEADING_FLIP = "heading flip"
    TWIN = "twin boxes"
    SIZE = "size"
    UNITS = "units"
    OFF_MAP = "off the map"
    LANE_GRAPH = "lane graph"
    LIGHT = "light without a lane"
    TRAFFIC = "traffic not recorded"


EFFECT = {
    Kind.PHANTOM: "left out of contacts, gaps and times to collision meanwhile; a drive that meets one is marked",
    Kind.EGO_GAP: "plans are compared with an interpolated drive there",
    Kind.EGO_JUMP: "open loop starts from states that were not driven; accuracy and comfort of the log are wrong there",
    Kind.EGO_SPEED: "speed errors, comfort and the start of every plan rest on a speed that the positions deny",
    Kind.EGO_HEADING: "lateral errors, and every plan that starts there, rest on a wrong heading",
    Kind.AGENT_GAP: "they are not in the scene in between, neither for planners nor for metrics",
    Kind.ID_SWITCH: "one road user counts as two, who appear and vanish; following and encounters are cut in two",
    Kind.TELEPORT: "time to collision, predictions and contacts are wrong around the jump",
    Kind.AGENT_SPEED: "predictions, times to collision and RSS rest on a speed that the positions deny",
    Kind.HEADING_FLIP: "their box turns on the spot: contacts and predictions are wrong for a moment",
    Kind.TWIN: "one road user counts twice in gaps and in the number of road users",
    Kind.SIZE: "contacts and gaps with them are those of a box that is hardly theirs",
    Kind.UNITS: "all that has metres or seconds in it is off by that factor",
    Kind.OFF_MAP: "lanes, limits, off road and rules do not fit what was driven",
    Kind.LANE_GRAPH: "routes may end early or go in a circle",
    Kind.LIGHT: "no car is asked to stop at it: red lights run are not counted",
    Kind.TRAFFIC: "nobody is there to be met: gaps and contacts of what is driven then are no evidence of safety",
}
"""What each does to which metric."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong.

    Attributes:
        kind: Of it.
        topic: Part of the scenario where it is: "ego", "agents", "road", "lights".
        who: The agent, lane or light, or "".
        t_from: When it begins, s since the scenario's start; `t_to` when it ends.
        t_to: See there.
        value: How much, in `unit`.
        unit: "m", "s", "rad", "x" (a factor), "1" (a count or a share).
        text: In words, with the figures.
    """

    kind: Kind
    topic: str
    who: str
    t_from: float
    t_to: float
    value: float
    unit: str
    text: str

    @property
    def effect(self) -> str:
        """What it does to which metric."""
        return EFFECT[self.kind]
