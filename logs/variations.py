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
from math import atan2, cos, hypot, nan, pi, sin
from types import MappingProxyType

import numpy as np

from logs.agents import USUAL_SIZE_M, AgentKind
from logs.errors import ConfigError, LogError, unknown_name
from logs.kernel import BoolArray, FloatArray
from logs.observed import MAX_AGE_S
from logs.road import ReferenceLine, thinned
from logs.scenario import Scenario, Tracks
from logs.shapes import overlap
from logs.states import Trajectory

VARIED = "varied"
"""Tag of a varied log, and begin of its metadata entries: `varied.of`, `varied.agents` (JSON), `varied.NAME`."""
LONGEST_S = 30.0
LATERAL_MPS2 = 4.89
"""An ego that would begin in a curve with more has no sensible state (nuPlan's comfort bound)."""
STANDING_MPS = 0.2
"""Slower is standing for sure: above what the noise of tracks leaves in smoothed speeds."""
GOING_MPS = 0.5
"""Faster is going for sure. Between them: faster than half of one's greatest speed, as smoothing spreads a start."""
COURSE_S = 1.0
"""The course at a time is that of the way from so long before to so long after it."""
COURSE_M = 0.3
"""A shorter way has no course: the heading of the box is taken."""
BEFORE_S = 2.0
"""So much of a varied log's tracks is kept before its begin and after its end: more than `logs.observed.MAX_GAP_S`."""
RATE_S = 0.1
WALKER, STANDER = "inserted pedestrian", "inserted car"
WALK_MPS = 1.4
"""Of an adult at a crossing (Fitzpatrick et al., TCRP Report 112, 2006: mean 1.45 m/s)."""
KERB_M = 6.0
"""How far beside the ego's path the inserted pedestrian begins and ends to walk: a lane and a half."""
LEAST_MPS = 3.0
"""An ego that stands at the start is taken to arrive at this speed."""
AROUND_S = 60.0
"""The walker stands at the kerbs so long before and after the log: more than time and speed can take away."""
COPY = "copy of "
_COLUMNS = ("t", "x", "y", "yaw", "vx", "vy")
Change = Callable[[Scenario, Sequence[str], float], Scenario]


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
    now = replace(now, tracks=continued(was, now), ego=start_of(now.ego))
    check_start(scenario, now)
    changes = ", ".join(f"{name} {VARIATIONS[name].shown(value)}" for name, value in ordered.items())
    agents = agents if any(VARIATIONS[name].of != "ego" for name in ordered) else ()
    about = f" of {', '.join(agents)}" if agents else ""
    notes = (
        f"Varied from {scenario.name}: {changes}{about}.",
        "Of the ego's log only the start is kept: it was driven in another world and is no reference in this one.",
        "A varied track goes straight on where its recording was cut by the begin or the end of the log.",
    )
    entries = {f"{VARIED}.{name}": repr(float(value)) for name, value in ordered.items()}
    kept = {key: text for key, text in scenario.metadata.items() if key != "expected_decisions"}
    early = -min(0, now.start_ns + round(1e9 * float(now.tracks.t.min(initial=0.0))))  # no sample before log time 0
    return replace(
        now,
        start_ns=now.start_ns + early,
        name=f"{scenario.name}~{','.join(f'{name}={value:.10g}' for name, value in ordered.items())}",
        controls=None,
        onboard=(),
        tags=tuple(dict.fromkeys((*(tag for tag in scenario.tags if tag != "recorded"), VARIED))),
        metadata={**kept, f"{VARIED}.of": scenario.name, f"{VARIED}.agents": json.dumps(list(agents)), **entries},
        notes=(*scenario.notes, *notes),
    )


def start_of(ego: Trajectory) -> Trajectory:
    """Its first state alone."""
    return ego.between(float(ego.t[0]), float(ego.t[0]))


def driven_line(scenario: Scenario) -> ReferenceLine:
    """The ego's driven path from its first state on; straight ahead where less than 2 m were driven."""
    ego, start = scenario.ego, scenario.ego.state(0)
    path = thinned(np.column_stack([ego.x, ego.y]), 1.0)
    if len(path) < 3:
        path = np.array([[start.x + s * cos(start.yaw), start.y + s * sin(start.yaw)] for s in (0.0, 1.0, 2.0)])
    return ReferenceLine.through(path)


def on_path(scenario: Scenario, s: float) -> tuple[float, float, float]:
    """Point and heading `s` m along the ego's driven path."""
    x, y, yaw, _ = driven_line(scenario).frame(s)
    return x, y, yaw


def ego_start(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """The scenario with the start of the ego moved along its path (4)."""
    start = scenario.ego.state(0)
    if value < 0.0:
        x, y, yaw, kappa = start.x + value * cos(start.yaw), start.y + value * sin(start.yaw), start.yaw, 0.0
    else:
        x, y, yaw, kappa = driven_line(scenario).frame(value)
    columns = (start.t, x, y, yaw, start.v, 0.0, kappa)
    return replace(scenario, ego=Trajectory(*(np.array([value]) for value in columns)))  # (4)


def ego_speed(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """The scenario with the speed of the ego's start times a factor (4)."""
    start = start_of(scenario.ego)
    return replace(scenario, ego=replace(start, v=value * start.v, a=np.zeros(1)))


def check_start(was: Scenario, now: Scenario) -> None:
    """LogError where the ego of `now` starts in an impossible state, or inside an agent that `was` did not touch."""
    start, before, road = now.ego.state(0), was.ego.state(0), now.road
    if road.is_drivable(before.x, before.y) and not road.is_drivable(start.x, start.y):
        raise LogError("the ego would start off the road", remedy="keep ego_start on it")
    lateral = start.v**2 * abs(start.kappa)
    if lateral > max(LATERAL_MPS2, before.v**2 * abs(before.kappa)):
        raise LogError(f"the ego would start at {start.v:.1f} m/s in a curve of {1.0 / abs(start.kappa):.0f} m radius")
    stands_in = [name for name in _touched_agents(now) if name not in _touched_agents(was)]
    if stands_in:
        raise LogError(f"{stands_in[0]} would stand in the ego at the start")


def _touched_agents(scenario: Scenario) -> list[str]:
    """Ids of those whose boxes the ego's touches at the start."""
    start, car = scenario.ego.state(0), scenario.vehicle
    x, y = start.x + car.axle_to_center * cos(start.yaw), start.y + car.axle_to_center * sin(start.yaw)
    others = scenario.tracks.truth(start.t)
    boxes = np.column_stack([others.x, others.y, others.yaw, others.length, others.width]).tolist()
    found = [overlap(x, y, start.yaw, car.length, car.width, *box) for box in boxes]
    return [name for name, touches in zip(others.ids, found, strict=True) if touches]


def places(tracks: Tracks, agents: Sequence[str]) -> list[int]:
    """Places of agents among the tracks; ConfigError where one is not there, or none is named."""
    missing = [agent for agent in agents if agent not in tracks.ids]
    if missing or not agents:
        what = f"no agent is called '{missing[0]}'" if missing else "no agent is named"
        raise ConfigError(f"{what}; `replan vary LOG --list-agents` lists them")
    return [tracks.ids.index(agent) for agent in agents]


def _theirs(tracks: Tracks, agents: Sequence[str]) -> BoolArray:
    """Which samples `(m,)` are theirs."""
    mine = np.zeros(len(tracks.t), np.bool_)
    for i in places(tracks, agents):
        mine[tracks.samples(i)] = True
    return mine


def _with_samples(tracks: Tracks, samples: Mapping[int, FloatArray]) -> Tracks:
    """The tracks with other samples `(k, 6)` of some, columns t, x, y, yaw, vx, vy."""
    rows = np.column_stack([getattr(tracks, name) for name in _COLUMNS])
    parts = [samples.get(i, rows[tracks.samples(i)]) for i in range(len(tracks))]
    columns = dict(zip(_COLUMNS, np.vstack([np.empty((0, len(_COLUMNS))), *parts]).T, strict=True))
    return replace(tracks, offsets=np.cumsum([0, *map(len, parts)]), **columns)


def with_agent(
    scenario: Scenario, name: str, kind: AgentKind, size: tuple[float, float], samples: FloatArray, *, static: bool
) -> Scenario:
    """The scenario with one more road user; LogError where there is one of that id."""
    tracks = scenario.tracks
    if name in tracks.ids:
        raise LogError(f"there is a {name} already")
    columns = {column: np.r_[getattr(tracks, column), samples[:, i]] for i, column in enumerate(_COLUMNS)}
    more = replace(
        tracks, ids=(*tracks.ids, name), kinds=(*tracks.kinds, kind), length=np.r_[tracks.length, size[0]],
        width=np.r_[tracks.width, size[1]], static=np.r_[tracks.static, static],
        offsets=np.r_[tracks.offsets, len(tracks.t) + len(samples)], **columns,
    )  # fmt: skip
    return replace(scenario, tracks=more)


def _samples(tracks: Tracks, i: int) -> FloatArray:
    """Samples `(k, 6)` of one."""
    return np.column_stack([getattr(tracks, name)[tracks.samples(i)] for name in _COLUMNS])


def in_time(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """The scenario with the agents shifted in time (1)."""
    tracks = scenario.tracks
    return replace(scenario, tracks=replace(tracks, t=tracks.t + value * _theirs(tracks, agents)))  # (1)


def in_speed(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """The scenario with the agents faster or slower (2)."""
    tracks, mine = scenario.tracks, _theirs(scenario.tracks, agents)
    speed = np.hypot(tracks.motion.vx, tracks.motion.vy)
    times, which = np.unique(tracks.t[mine], return_inverse=True)
    mean = np.bincount(which, weights=speed[mine]) / np.bincount(which)
    slow = min(max(0.5 * float(mean.max()), STANDING_MPS), GOING_MPS)
    moves = 0.5 * (mean[1:] + mean[:-1]) >= slow
    clock = times[0] + np.r_[0.0, np.cumsum(np.where(moves, np.diff(times) / value, np.diff(times)))]  # (2)
    changed = {}
    for i in places(tracks, agents):
        rows, gaps = _samples(tracks, i), tracks.gap_after[tracks.samples(i)]
        own = np.interp(rows[:, 0], times, clock)
        rows[:, 4:] *= np.where(speed[tracks.samples(i)] >= slow, value, 1.0)[:, None]
        spacing, rows = np.diff(rows[:, 0]), np.column_stack([own, rows[:, 1:]])
        if len(rows) > 1:  # more samples between two that are further apart than before, but not in gaps
            parts = np.where(gaps[:-1], 1, np.ceil(np.diff(own) / spacing - 1e-9)).astype(np.int64)
            fine = [k + np.arange(n) / n for k, n in enumerate(np.maximum(parts, 1))]
            at = np.concatenate([*fine, [len(rows) - 1.0]])
            rows = np.column_stack([np.interp(at, np.arange(len(rows)), column) for column in rows.T])
        changed[i] = rows
    return replace(scenario, tracks=_with_samples(tracks, changed))


def sideways(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """The scenario with the agents shifted to the side (3)."""
    tracks, ego, mine = scenario.tracks, scenario.ego, _theirs(scenario.tracks, agents)
    nearest = []  # how near each agent comes to the ego, m, and their course there, rad: the box's where they stand
    for i in places(tracks, agents):
        rows = _samples(tracks, i)
        to_x = rows[:, 1] - np.interp(rows[:, 0], ego.t, ego.x)
        to_y = rows[:, 2] - np.interp(rows[:, 0], ego.t, ego.y)
        away = np.hypot(to_x, to_y)
        at = int(np.argmin(away))
        near = np.flatnonzero(np.abs(rows[:, 0] - rows[at, 0]) <= COURSE_S)
        dx, dy = (rows[near[-1], 1:3] - rows[near[0], 1:3]).tolist()
        nearest.append((float(away[at]), atan2(dy, dx) if hypot(dx, dy) >= COURSE_M else float(rows[at, 3])))
    _, course = min(nearest)
    x, y = tracks.x - value * sin(course) * mine, tracks.y + value * cos(course) * mine  # (3)
    return replace(scenario, tracks=replace(tracks, x=x, y=y))


def removed(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """Without the agents, whatever the value."""
    return replace(scenario, tracks=scenario.tracks.taken(~_theirs(scenario.tracks, agents)))


def copied(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """With a second one of each agent, `value` s later."""
    tracks = scenario.tracks
    for i in places(tracks, agents):
        rows = _samples(tracks, i)
        rows[:, 0] += value
        size = float(tracks.length[i]), float(tracks.width[i])
        name, static = f"{COPY}{tracks.ids[i]}", bool(tracks.static[i])
        scenario = with_agent(scenario, name, tracks.kinds[i], size, rows, static=static)
    return scenario


def pedestrian(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """With an adult who crosses `value` m ahead."""
    x, y, yaw = on_path(scenario, value)
    start, car = scenario.ego.state(0), scenario.vehicle
    meet = start.t + max(value - car.axle_to_front, 0.0) / max(start.v, LEAST_MPS)
    t = np.arange(-AROUND_S, scenario.duration + AROUND_S, RATE_S)
    l = np.clip(WALK_MPS * (t - meet), -KERB_M, KERB_M)  # noqa: E741
    v = np.where(np.abs(l) < KERB_M, WALK_MPS, 0.0)
    rows = [t, x - l * sin(yaw), y + l * cos(yaw), np.full(len(t), yaw + 0.5 * pi), -v * sin(yaw), v * cos(yaw)]
    kind = AgentKind.PEDESTRIAN
    return with_agent(scenario, WALKER, kind, USUAL_SIZE_M[kind], np.column_stack(rows), static=False)


def standing_car(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """With a car that stands `value` m ahead."""
    kind = AgentKind.CAR
    size = USUAL_SIZE_M[kind]
    x, y, yaw = on_path(scenario, value + 0.5 * size[0])
    return with_agent(scenario, STANDER, kind, size, np.array([[0.0, x, y, yaw, 0.0, 0.0]]), static=True)


def continued(was: Scenario, now: Scenario) -> Tracks:
    """The tracks of `now`; those shifted in time since `was` are extended where the begin or end of the log cut them.

    `was` holds the inserted road users, too; a copy is compared with its original. Samples far outside of the log are
    cut.
    """
    tracks, end, changed = now.tracks, now.duration, {}
    known = {name: i for i, name in enumerate(was.tracks.ids)}
    for i in np.flatnonzero(~tracks.static).tolist():
        name = tracks.ids[i]
        recorded = was.tracks.t[was.tracks.samples(known[name if name in known else name.removeprefix(COPY)])]
        rows, mine = _samples(tracks, i), tracks.samples(i)
        if np.array_equal(recorded, rows[:, 0]):
            continue
        vx, vy = tracks.motion.vx[mine], tracks.motion.vy[mine]
        if recorded[0] <= MAX_AGE_S and rows[0, 0] > 0.0:
            before = np.arange(-BEFORE_S, rows[0, 0] - 1e-9, RATE_S)
            rows = np.vstack([_straight(rows[0], vx[0], vy[0], before), rows])
        if recorded[-1] >= end - MAX_AGE_S and rows[-1, 0] < end:
            after = rows[-1, 0] + RATE_S * np.arange(1, int((end - rows[-1, 0]) / RATE_S) + 3)
            rows = np.vstack([rows, _straight(rows[-1], vx[-1], vy[-1], after)])
        changed[i] = rows
    carried = _with_samples(tracks, changed)
    static = np.repeat(carried.static, np.diff(carried.offsets))
    return carried.taken(static | (carried.t >= -BEFORE_S) & (carried.t <= end + BEFORE_S))


def _straight(row: FloatArray, vx: float, vy: float, t: FloatArray) -> FloatArray:
    """Samples at `t` `(k,)` of an agent that goes straight through a sample (6,) at a constant velocity, or stands."""
    vx, vy = (vx, vy) if hypot(vx, vy) >= STANDING_MPS else (0.0, 0.0)
    one, late = np.ones(len(t)), t - row[0]
    return np.column_stack([t, row[1] + vx * late, row[2] + vy * late, row[3] * one, vx * one, vy * one])


_TABLE = (
    Variation(
        "pedestrian", "m", 1.0, 500.0, nan,
        "an adult crosses the ego's path so far ahead of its start, from the right, and is in its middle when the "
        "front of an ego that keeps its speed is there", pedestrian, of=WALKER,
    ),
    Variation(
        "standing_car", "m", 1.0, 500.0, nan, "a car stands on the ego's path, its rear so far ahead of the ego's rear "
        "axle at the start", standing_car, of=STANDER,
    ),
    Variation("copy", "s", -LONGEST_S, LONGEST_S, nan, "each agent is followed by a copy so much later", copied),
    Variation("side", "m", -50.0, 50.0, 0.0, "the agents are so far to the left of their course", sideways),
    Variation("speed", "1", 0.2, 5.0, 1.0, "factor of the agents' speed along their path", in_speed),
    Variation("time", "s", -LONGEST_S, LONGEST_S, 0.0, "the agents come so much later", in_time),
    Variation("remove", "1", 0.0, 1.0, 0.0, "1: the agents are not there", removed, is_choice=True),
    Variation("ego_start", "m", -200.0, 200.0, 0.0, "the ego starts so far along its path", ego_start, of="ego"),
    Variation("ego_speed", "1", 0.0, 3.0, 1.0, "factor of the ego's speed at the start", ego_speed, of="ego"),
)  # fmt: skip
VARIATIONS: Mapping[str, Variation] = MappingProxyType({each.name: each for each in _TABLE})
"""By name, in the order in which they are applied."""
