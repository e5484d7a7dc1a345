"""Varies a log: time, speed, place and presence of road users (agent_changes.py), place and speed
of the ego's start.

Each `Variation` is a pure function (scenario, agents, value) -> scenario; its neutral value changes
nothing. `varied` applies several variations in the order of the table, and records them in name,
tags, metadata and notes.

(1) ego      pose and curvature at station s of the driven path, straight on before its begin; the
             start's speed times k; no acceleration

The recorded drive does not fit the varied traffic: only the start of the ego's log is kept, and the
tag "varied" replaces "recorded". Metrics then neither compare a planner with the recorded driver
nor excuse a broken bound by that driver; they use the careful driver
(`replan.metrics.reference_drivers`) for both.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from types import MappingProxyType

import numpy as np

from replan.core.errors import ConfigError, LogError, unknown_name
from replan.logs.edit.agent_changes import (
    STANDER,
    WALKER,
    continued,
    copied,
    driven_line,
    in_speed,
    in_time,
    pedestrian,
    removed,
    sideways,
    standing_car,
)
from replan.logs.scenario import Scenario
from replan.logs.shapes import overlap
from replan.logs.states import Trajectory

VARIED = "varied"
"""Tag of a varied log, and prefix of its metadata entries: `varied.of`, `varied.agents` (JSON),
`varied.NAME`.
"""
LONGEST_S = 30.0
LATERAL_MPS2 = 4.89
"""Greatest lateral acceleration of the ego's start, m/s2 (nuPlan's comfort bound)."""
Change = Callable[[Scenario, Sequence[str], float], Scenario]


@dataclass(frozen=True)
class Variation:
    """One way of varying a scenario.

    Attributes:
        name: Its name in `--vary NAME=...`.
        unit: Unit of its value; "1": a factor or a choice.
        low: Least value.
        high: Greatest value.
        neutral: The value that changes nothing; NaN: every value changes something.
        summary: Meaning of a value, in one line.
        change: (scenario, ids of the agents, value) -> scenario; raises LogError if there is no
            such scenario.
        of: The varied object: "agent", "ego", or the id of the agent that it inserts.
        is_choice: Whether only the two bounds are distinct values.
    """

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    summary: str
    change: Change
    of: str = "agent"
    is_choice: bool = False

    def __call__(self, scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
        """Return the varied scenario, with its old name and tags; the scenario itself if the value
        is neutral.

        Raises:
            ConfigError: The value is out of range, or an agent is unknown.
            LogError: There is no such scenario.
        """
        self.check(value)
        return scenario if value == self.neutral else self.change(scenario, agents, value)

    def check(self, value: float) -> None:
        """Raise ConfigError if the value is out of range."""
        if not self.low <= value <= self.high:
            raise ConfigError(
                f"{self.name} is {value:g}, it must be from {self.low:g} to {self.shown(self.high)}"
            )

    def shown(self, value: float) -> str:
        """The value with its unit."""
        return f"{value:.10g}" if self.unit == "1" else f"{value:.10g} {self.unit}"

    @property
    def inserts(self) -> str:
        """Id of the agent that it inserts; "": none."""
        return "" if self.of in ("agent", "ego") else self.of


def varied(scenario: Scenario, agents: Sequence[str], values: Mapping[str, float]) -> Scenario:
    """Apply several variations in the order of the table, record them, and keep only the ego's
    start.

    `agents` are varied together; empty: those that the variations insert. `values` are by name of
    `VARIATIONS`.

    Raises:
        ConfigError: A name or an agent is unknown, or a value out of range.
        LogError: There is no such scenario: the ego would start off the road, too fast for a curve,
            or in an agent.
    """
    for name in values:
        if name not in VARIATIONS:
            raise unknown_name("variation", name, VARIATIONS)
    ordered = {name: values[name] for name in VARIATIONS if name in values}
    agents = agents or tuple(
        VARIATIONS[name].inserts for name in ordered if VARIATIONS[name].inserts
    )
    before = varied_scenario = scenario
    for name, value in ordered.items():
        varied_scenario = VARIATIONS[name](varied_scenario, agents, value)
        before = varied_scenario if VARIATIONS[name].inserts else before
    varied_scenario = replace(
        varied_scenario,
        tracks=continued(before, varied_scenario),
        ego=start_of(varied_scenario.ego),
    )
    check_start(scenario, varied_scenario)
    changes = ", ".join(
        f"{name} {VARIATIONS[name].shown(value)}" for name, value in ordered.items()
    )
    agents = agents if any(VARIATIONS[name].of != "ego" for name in ordered) else ()
    about = f" of {', '.join(agents)}" if agents else ""
    notes = (
        f"Varied from {scenario.name}: {changes}{about}.",
        "Only the start of the ego's log is kept: the drive was recorded in other traffic, so it "
        "is no reference here.",
        "A varied track continues straight before the begin and after the end of its recording.",
    )
    entries = {f"{VARIED}.{name}": repr(float(value)) for name, value in ordered.items()}
    metadata = {key: text for key, text in scenario.metadata.items() if key != "expected_decisions"}
    # No sample before log time 0
    early = -min(
        0, varied_scenario.start_ns + round(1e9 * float(varied_scenario.tracks.t.min(initial=0.0)))
    )
    suffix = ",".join(f"{name}={value:.10g}" for name, value in ordered.items())
    return replace(
        varied_scenario,
        start_ns=varied_scenario.start_ns + early,
        name=f"{scenario.name}~{suffix}",
        controls=None,
        onboard=(),
        tags=tuple(dict.fromkeys((*(tag for tag in scenario.tags if tag != "recorded"), VARIED))),
        metadata={
            **metadata,
            f"{VARIED}.of": scenario.name,
            f"{VARIED}.agents": json.dumps(list(agents)),
            **entries,
        },
        notes=(*scenario.notes, *notes),
    )


def start_of(ego: Trajectory) -> Trajectory:
    """Return the trajectory with only its first state."""
    return ego.between(float(ego.t[0]), float(ego.t[0]))


def ego_start(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """The scenario with the start of the ego moved along its path (1)."""
    start = scenario.ego.state(0)
    if value < 0.0:
        (x, y), yaw, kappa = start.ahead(value), start.yaw, 0.0
    else:
        x, y, yaw, kappa = driven_line(scenario).frame(value)
    columns, goal = (start.t, x, y, yaw, start.v, 0.0, kappa), scenario.goal
    goal = goal and goal.after(value)
    # (1)
    ego = Trajectory(*(np.array([value]) for value in columns))
    return replace(scenario, ego=ego, before=None, goal=goal)


def ego_speed(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """The scenario with the speed of the ego's start times a factor (1)."""
    start = start_of(scenario.ego)
    ego = replace(start, v=value * start.v, a=np.zeros(1))
    return replace(scenario, ego=ego, before=None)


def check_start(original: Scenario, varied_scenario: Scenario) -> None:
    """Raise LogError if the ego of a varied scenario starts in an impossible state, or in an agent
    that it does not touch in the original.
    """
    start, before, road = varied_scenario.ego.state(0), original.ego.state(0), varied_scenario.road
    if road.is_drivable(before.x, before.y) and not road.is_drivable(start.x, start.y):
        raise LogError("the ego would start off the road", remedy="keep ego_start on it")
    lateral = start.v**2 * abs(start.kappa)
    if lateral > max(LATERAL_MPS2, before.v**2 * abs(before.kappa)):
        raise LogError(
            f"the ego would start at {start.v:.1f} m/s in a curve of {1.0 / abs(start.kappa):.0f} "
            "m radius"
        )
    stands_in = [
        name for name in _touched_agents(varied_scenario) if name not in _touched_agents(original)
    ]
    if stands_in:
        raise LogError(f"{stands_in[0]} would stand in the ego at the start")


def _touched_agents(scenario: Scenario) -> list[str]:
    start, car = scenario.ego.state(0), scenario.vehicle
    x, y = start.ahead(car.axle_to_center)
    others = scenario.tracks.truth(start.t)
    boxes = np.column_stack([others.x, others.y, others.yaw, others.length, others.width]).tolist()
    overlaps = [overlap(x, y, start.yaw, car.length, car.width, *box) for box in boxes]
    return [name for name, touches in zip(others.ids, overlaps, strict=True) if touches]


_TABLE = (
    Variation(
        name="pedestrian",
        unit="m",
        low=1.0,
        high=500.0,
        neutral=nan,
        summary=(
            "an adult crosses the ego's path from the right at this distance from its start, and "
            "is in its middle when the front of an ego at constant speed arrives"
        ),
        change=pedestrian,
        of=WALKER,
    ),
    Variation(
        name="standing_car",
        unit="m",
        low=1.0,
        high=500.0,
        neutral=nan,
        summary=(
            "a car stands on the ego's path, its rear at this distance ahead of the "
            "ego's rear axle at the start"
        ),
        change=standing_car,
        of=STANDER,
    ),
    Variation(
        name="copy",
        unit="s",
        low=-LONGEST_S,
        high=LONGEST_S,
        neutral=nan,
        summary="each agent is followed by a copy, later by this time",
        change=copied,
    ),
    Variation(
        name="side",
        unit="m",
        low=-50.0,
        high=50.0,
        neutral=0.0,
        summary="the agents are shifted left of their course by this",
        change=sideways,
    ),
    Variation(
        name="speed",
        unit="1",
        low=0.2,
        high=5.0,
        neutral=1.0,
        summary="factor of the agents' speed along their path",
        change=in_speed,
    ),
    Variation(
        name="time",
        unit="s",
        low=-LONGEST_S,
        high=LONGEST_S,
        neutral=0.0,
        summary="the agents come later by this time",
        change=in_time,
    ),
    Variation(
        name="remove",
        unit="1",
        low=0.0,
        high=1.0,
        neutral=0.0,
        summary="1: the agents are removed",
        change=removed,
        is_choice=True,
    ),
    Variation(
        name="ego_start",
        unit="m",
        low=-200.0,
        high=200.0,
        neutral=0.0,
        summary="the ego starts this far along its path",
        change=ego_start,
        of="ego",
    ),
    Variation(
        name="ego_speed",
        unit="1",
        low=0.0,
        high=3.0,
        neutral=1.0,
        summary="factor of the ego's speed at the start",
        change=ego_speed,
        of="ego",
    ),
)
VARIATIONS: Mapping[str, Variation] = MappingProxyType(
    {variation.name: variation for variation in _TABLE}
)
"""The variations by name, in the order in which they are applied."""
