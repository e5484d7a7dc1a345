"""What may be varied in a log: road users in time, speed and place, who is there, where and how fast the ego starts.

Each `Variation` is a pure function (scenario, agents, value) -> scenario; its neutral value gives the scenario itself.
`varied` applies several, in the order of the table, and signs the result.

(1) time     t' = t + dt
(2) speed    dt' = dt / k while the agents walk or drive, dt' = dt while they stand; v' = k v. All who are varied share
             this clock, which begins with the first sample of any of them, so that a road user who was tracked in
             pieces stays in one piece. Positions stay on the recorded path: where samples would come more rarely than
             they were recorded, the way between two is divided.
(3) side     p' = p + d n       n: left of the course where they come nearest to the ego, one for all who are varied
(4) ego      pose and curvature at way s of the driven path, straight back before its begin; the speed of the start,
             k times; no acceleration

A drive that was recorded among others than there are now is no drive in this world: of the ego's log only the start is
left, and the tag "recorded" gives way to "varied". No metric measures a planner by the recorded driver then, and no
broken bound is excused by that driver; the careful driver (`metrics.reference_drivers`) takes both places.

Who was in the recording from its begin, or up to its end, goes straight on at their first (last) velocity where the
varied track would leave that time uncovered; who came or went within the recording still does.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from types import MappingProxyType

from logs.errors import ConfigError, unknown_name
from logs.scenario import Scenario
from logs.variations import ego, tracks

VARIED = "varied"
"""Tag of a varied log, and begin of its metadata entries: `varied.of`, `varied.agents` (JSON), `varied.NAME`."""
LONGEST_S = 30.0

Change = Callable[[Scenario, Sequence[str], float], Scenario]

__all__ = ["VARIATIONS", "VARIED", "Variation", "varied"]


@dataclass(frozen=True)
class Variation:
    """One thing that may be varied.

    Attributes:
        name: As in `--vary NAME=...`.
        unit: Of its value; "1": a factor or a choice.
        low: Least value; `high` the greatest.
        neutral: The value that changes nothing; NaN: every value changes something.
        summary: What a value means, in one line.
        change: (scenario, ids of the agents, value) -> scenario; raises LogError where there is no such scenario.
        of: What it changes: "agent", "ego", or the id of the agent that it inserts.
        is_choice: Whether there is nothing between two values.
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
        """The varied scenario, not signed; the scenario itself where the value is neutral.

        Raises:
            ConfigError: The value is out of range, or an agent is not there.
            LogError: There is no such scenario.
        """
        self.check(value)
        return scenario if value == self.neutral else self.change(scenario, agents, value)

    def check(self, value: float) -> None:
        """ConfigError where the value is out of range."""
        if not self.low <= value <= self.high:
            raise ConfigError(f"{self.name} is {value:g}, it must be from {self.low:g} to {self.shown(self.high)}")

    def shown(self, value: float) -> str:
        """The value with its unit."""
        return f"{value:.10g}" if self.unit == "1" else f"{value:.10g} {self.unit}"

    @property
    def inserts(self) -> str:
        """Id of the agent that it inserts; "": none."""
        return "" if self.of in ("agent", "ego") else self.of


def varied(scenario: Scenario, agents: Sequence[str], values: Mapping[str, float]) -> Scenario:
    """The scenario with several variations, in the order of the table, signed and with the ego's start only.

    Args:
        scenario: As it was recorded or synthesised.
        agents: Ids of those who are varied together; empty: who is tracks.
        values: Value by name of `VARIATIONS`.

    Raises:
        ConfigError: A name or an agent is unknown, or a value out of range.
        LogError: There is no such scenario: the ego would start off the road, too fast for a curve, or in an agent.
    """
    for name in values:
        if name not in VARIATIONS:
            raise unknown_name("variation", name, VARIATIONS)
    ordered = {name: values[name] for name in VARIATIONS if name in values}
    agents = agents or tuple(VARIATIONS[name].inserts for name in ordered if VARIATIONS[name].inserts)
    was = now = scenario
    for name, value in ordered.items():
        now = VARIATIONS[name](now, agents, value)
        was = now if VARIATIONS[name].inserts else was
    now = replace(now, tracks=tracks.continued(was, now), ego=ego.start_of(now.ego))
    ego.check_start(scenario, now)
    return _signed(scenario, now, agents, ordered)


def _signed(was: Scenario, now: Scenario, agents: Sequence[str], values: Mapping[str, float]) -> Scenario:
    changes = ", ".join(f"{name} {VARIATIONS[name].shown(value)}" for name, value in values.items())
    agents = agents if any(VARIATIONS[name].of != "ego" for name in values) else ()
    about = f" of {', '.join(agents)}" if agents else ""
    notes = (
        f"Varied from {was.name}: {changes}{about}.",
        "Of the ego's log only the start is kept: it was driven in another world and is no reference in this one.",
        "A varied track goes straight on where its recording was cut by the begin or the end of the log.",
    )
    entries = {f"{VARIED}.{name}": repr(float(value)) for name, value in values.items()}
    kept = {key: text for key, text in was.metadata.items() if key != "expected_decisions"}
    early = -min(0, now.start_ns + round(1e9 * float(now.tracks.t.min(initial=0.0))))  # no sample before log time 0
    return replace(
        now,
        start_ns=now.start_ns + early,
        name=f"{was.name}~{','.join(f'{name}={value:.10g}' for name, value in values.items())}",
        controls=None,
        onboard=(),
        tags=tuple(dict.fromkeys((*(tag for tag in was.tags if tag != "recorded"), VARIED))),
        metadata={**kept, f"{VARIED}.of": was.name, f"{VARIED}.agents": json.dumps(list(agents)), **entries},
        notes=(*was.notes, *notes),
    )


_TABLE = (
    Variation(
        "pedestrian", "m", 1.0, 500.0, nan,
        "an adult crosses the ego's path so far ahead of its start, from the right, and is in its middle when the "
        "front of an ego that keeps its speed is there", tracks.pedestrian, of=tracks.WALKER,
    ),
    Variation(
        "standing_car", "m", 1.0, 500.0, nan, "a car stands on the ego's path, its rear so far ahead of the ego's rear "
        "axle at the start", tracks.standing_car, of=tracks.STANDER,
    ),
    Variation("copy", "s", -LONGEST_S, LONGEST_S, nan, "each agent is followed by a copy so much later", tracks.copied),
    Variation("side", "m", -50.0, 50.0, 0.0, "the agents are so far to the left of their course", tracks.sideways),
    Variation("speed", "1", 0.2, 5.0, 1.0, "factor of the agents' speed along their path", tracks.in_speed),
    Variation("time", "s", -LONGEST_S, LONGEST_S, 0.0, "the agents come so much later", tracks.in_time),
    Variation("remove", "1", 0.0, 1.0, 0.0, "1: the agents are not there", tracks.removed, is_choice=True),
    Variation("ego_start", "m", -200.0, 200.0, 0.0, "the ego starts so far along its path", ego.ego_start, of="ego"),
    Variation("ego_speed", "1", 0.0, 3.0, 1.0, "factor of the ego's speed at the start", ego.ego_speed, of="ego"),
)  # fmt: skip
VARIATIONS: Mapping[str, Variation] = MappingProxyType({each.name: each for each in _TABLE})
"""By name, in the order in which they are applied."""
