"""What is remembered of the frames before, in one lane; a fresh frame is `LaneMemory()`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf

from logs.kernel import FloatArray
from planners.dp_qp.path.bounds import InTheWay
from planners.dp_qp.path.stage import PathMemory
from planners.dp_qp.scene.caps import PassTarget
from planners.dp_qp.speed.stage import SpeedMemory
from planners.rules import RuleMemory

FORGET_S = 0.5
"""A lane that was not planned for so long is planned as if for the first time, s."""


@dataclass(frozen=True, eq=False, slots=True)
class PassWay:
    """Those that a plan is to pass while they go on, and what the path stage is given for it."""

    targets: tuple[PassTarget, ...]
    way: InTheWay


@dataclass(frozen=True, eq=False, slots=True)
class LaneMemory:
    """Of one lane.

    Attributes:
        t: When it was planned last, s.
        place: x, y and station of the last start, m; None: unknown.
        path: Of the path stage; `speed` of the speed stage; `rules` of the rules.
    """

    t: float = -inf
    place: tuple[float, float, float] | None = None
    path: PathMemory = field(default_factory=PathMemory)
    speed: SpeedMemory = field(default_factory=SpeedMemory)
    rules: RuleMemory = field(default_factory=RuleMemory)


@dataclass(frozen=True, eq=False, slots=True)
class PassMemory:
    """Of passing those who are slower, in one lane.

    Attributes:
        t: When it was thought of last, s.
        passed: Those that the ego is passing.
        given_up: Who was not passed in the end, when, s.
        stations: Of the last plan that passes, at the times of the predictions since `t` `(k,)`, m; None: none.
        lane: Of the plans that pass, apart from those that keep the lane.
    """

    t: float = -inf
    passed: frozenset[str] = frozenset()
    given_up: Mapping[str, float] = field(default_factory=dict)
    stations: FloatArray | None = None
    lane: LaneMemory = field(default_factory=LaneMemory)
