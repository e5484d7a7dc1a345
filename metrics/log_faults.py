"""The kinds of faults of a log, with the effect of each on metrics, and the findings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.scenario import Scenario

BRAKING_MPS2 = 12.0
"""More than tyres can provide, m/s2."""
FACTORS = {
    3.6: "the speeds look like km/h",
    2.237: "the speeds look like mph",
    100.0: "the speeds look like cm/s",
    1000.0: "the speeds look like mm/s, the positions like km, or the times like ms",
    0.3048: "the positions look like feet",
    0.01: "the positions look like cm",
    0.001: "the positions look like mm",
}
"""Distance by speed over distance by positions, if one of them has a wrong unit."""
NEAR = 0.04
"""Tolerance of a factor, as a share."""
CLOSE_S = 0.09
"""Speeds and positions are compared at 10 Hz at most."""


class FaultKind(Enum):
    """The kinds of faults: topic of the scenario, unit of the value, and the `effect` on metrics.

    Units: "m", "s", "rad", "x" (a factor), "1" (a count or a share).
    """

    topic: str
    unit: str
    effect: str

    PHANTOM = (
        "phantom",
        "agents",
        "s",
        "left out of contacts, gaps and times to collision meanwhile; a drive that meets one is "
        "marked",
    )
    EGO_GAP = "ego gap", "ego", "s", "plans are compared with an interpolated drive there"
    EGO_JUMP = (
        "ego jump",
        "ego",
        "m",
        "open loop starts from states that were not driven; accuracy and comfort of the log are "
        "wrong there",
    )
    EGO_SPEED = (
        "ego speed",
        "ego",
        "x",
        "speed errors, comfort and starts of plans use a speed that contradicts the positions",
    )
    EGO_HEADING = (
        "ego heading",
        "ego",
        "rad",
        "lateral errors, and every plan that starts there, rest on a wrong heading",
    )
    EGO_POINT = (
        "ego point",
        "ego",
        "m",
        "lateral errors in bends, gaps and contacts are off by that distance",
    )
    AGENT_GAP = (
        "flickering",
        "agents",
        "1",
        "they are not in the scene in between, neither for planners nor for metrics",
    )
    ID_SWITCH = (
        "id switch",
        "agents",
        "m",
        "one road user counts as two, who appear and vanish; following and encounters are cut in "
        "two",
    )
    TELEPORT = (
        "teleport",
        "agents",
        "m",
        "time to collision, predictions and contacts are wrong around the jump",
    )
    AGENT_SPEED = (
        "agent speed",
        "agents",
        "x",
        "predictions, times to collision and RSS use a speed that contradicts the positions",
    )
    HEADING_FLIP = (
        "heading flip",
        "agents",
        "rad",
        "their box turns on the spot: contacts and predictions are wrong for a moment",
    )
    AGENT_HEADING = (
        "agent heading",
        "agents",
        "rad",
        "predictions, lanes, gaps and contacts of these boxes rest on a wrong heading",
    )
    VELOCITY = (
        "velocity direction",
        "agents",
        "rad",
        "predictions and times to collision go where no road user went",
    )
    ACROSS = (
        "motion across the axis",
        "agents",
        "rad",
        "predictions cross the ego's way where no road user went",
    )
    SHORT = (
        "short tracks",
        "agents",
        "1",
        "the motion of briefly visible road users is unknown; many may be false detections",
    )
    TWIN = (
        "twin boxes",
        "agents",
        "s",
        "one road user is counted twice in gaps and in the number of road users",
    )
    SIZE = "size", "agents", "m", "contacts and gaps with them use a box that is probably wrong"
    UNITS = "units", "agents", "x", "all that has metres or seconds in it is off by that factor"
    OFF_MAP = (
        "off the map",
        "road",
        "1",
        "lanes, limits, off road and rules do not fit what was driven",
    )
    LANE_GRAPH = "lane graph", "road", "m", "routes may end early or go in a circle"
    LIGHT = (
        "light without a lane",
        "lights",
        "1",
        "no car is asked to stop at it: red lights run are not counted",
    )
    GOAL = (
        "goal",
        "goal",
        "1",
        "a drive shows nothing about the way to it, or almost nothing: the verdict is inconclusive",
    )
    TRAFFIC = (
        "traffic not recorded",
        "agents",
        "s",
        "gaps and contacts of what is driven then are no evidence of safety",
    )

    def __new__(cls, word: str, topic: str, unit: str, effect: str) -> FaultKind:
        """The word is the value."""
        kind = object.__new__(cls)
        kind._value_, kind.effect = word, effect
        kind.topic, kind.unit = topic, unit
        return kind


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a log, from `t_from` to `t_to`, s since the scenario's start."""

    kind: FaultKind
    t_from: float
    t_to: float
    value: float
    text: str
    who: str = ""  # The agent, lane or light, or ""
    topic: str = ""  # The part of the scenario; "": that of the kind
    unit: str = ""  # Unit of the value; "": that of the kind

    def __post_init__(self) -> None:
        for name in ("topic", "unit"):
            object.__setattr__(self, name, getattr(self, name) or getattr(self.kind, name))


Report = Callable[[Scenario], Iterator[Finding]]
"""A check that reports what looks wrong."""


def unit_meaning(factor: float) -> str:
    """Return what a ratio of distances by speed and by positions means; "" if it is no factor of
    `FACTORS`.
    """
    for wrong_unit, meaning in FACTORS.items():
        if abs(factor / wrong_unit - 1.0) < NEAR:
            return meaning
    return ""


def distances(
    t: FloatArray, x: FloatArray, y: FloatArray, v: FloatArray, gap_after: BoolArray
) -> tuple[float, float]:
    """Return the distance by positions and by the speeds `v` `(n,)` >= 0, m, without the steps with
    a gap.

    Samples closer than `CLOSE_S` are left out: their steps are noise.
    """
    _, firsts = np.unique((t - t[0]) // CLOSE_S, return_index=True)
    rows = np.unique(np.append(firsts, len(t) - 1))
    observed = np.empty(0, np.bool_)
    if len(rows) > 1:
        observed = ~np.logical_or.reduceat(gap_after, rows[:-1])
    speed = v[rows]
    by_positions = np.hypot(np.diff(x[rows]), np.diff(y[rows]))
    by_speeds = 0.5 * np.diff(t[rows]) * (speed[1:] + speed[:-1])
    return float(by_positions[observed].sum()), float(by_speeds[observed].sum())


def degrees_question(yaw: FloatArray) -> str:
    """Return a question for headings that contradict the motion: those beyond a turn may be
    degrees.
    """
    return "; in degrees?" if np.abs(yaw).max() > 2.0 * np.pi else ""
