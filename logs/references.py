"""What reference drivers do in a scenario: a yardstick for planners. Replay computes it; it is not part of a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import nan


class Avoidability(Enum):
    """Whether a reference driver avoids a collision."""

    AVOIDABLE = "avoidable"
    UNAVOIDABLE = "unavoidable"
    NOT_APPLICABLE = "not applicable"


@dataclass(frozen=True, slots=True)
class DriverVerdict:
    """The verdict of a reference driver ("cc" or "fsm") on a scenario, and its reason.

    Attributes:
        brakes: When it begins to brake with more than 1 m/s2, s since the scenario's start; NaN: never.
        meets: When it touches an agent, s; NaN: never.
        speed: Speed at the touch, else at the end, m/s.
        agent: Id of the agent that the driver touches, else of the one that it would touch without braking; "": none.
        margin: (6) of `metrics.reference_drivers`, m; NaN without an agent.
        marginal: Whether a small change would change the verdict.
    """

    driver: str
    outcome: Avoidability
    reason: str
    brakes: float = nan
    meets: float = nan
    speed: float = nan
    agent: str = ""
    margin: float = nan
    marginal: bool = False


@dataclass(frozen=True, slots=True)
class References:
    """The reference drives of a scenario.

    Attributes:
        verdicts: By driver ("cc", "fsm"); empty: the drivers did not judge the scenario.
        follower_gain: How far the route follower gets along the route, m; None: it was not driven.
    """

    verdicts: Mapping[str, DriverVerdict] = field(default_factory=dict)
    follower_gain: float | None = None
