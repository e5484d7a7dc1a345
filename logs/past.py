"""What a planner knew before a frame: the ego, the agents and the lights of the last 2.1 s.

A drive's frames become `Snapshot`s. A past has the snapshots at

(1) tau_k = t - k `PAST_STEP_S`,  k = `PAST_STEPS` ... 1

of each the last known snapshot up to tau_k, moved with its velocities where it is older. Before the
first frame of a drive the log is asked; before the log begins, the ego drove as it does at first,
on its arc, and no agent was seen. nuPlan's planners get the same: 21 steps of 0.1 s and the present
(`nuplan.planning.simulation.history.simulation_history_buffer`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.agents import AgentKind, Agents
from replan.logs.rules import Colour
from replan.logs.states import EgoState

PAST_STEP_S = 0.1
PAST_STEPS = 21
PAST_S = PAST_STEPS * PAST_STEP_S
"""Length of a past, s: that of nuPlan's planners."""
SAME_TIME_S = 1e-6
STEP_NS = round(1e9 * PAST_STEP_S)
MOTION = ("x", "y", "yaw", "vx", "vy")
"""Columns of `Agents` that a past has over time."""


class PastSource(Enum):
    """Where a step of a past comes from: from a frame of the drive; from the log before its first
    frame; or nothing is known, and the first known state is moved back.
    """

    DRIVE = "drive"
    LOG = "log"
    HELD = "held"


@dataclass(frozen=True, eq=False, slots=True)
class Snapshot:
    """What was known at one instant; attributes as in `Frame`."""

    t: float
    ego: EgoState
    agents: Agents
    lights: Mapping[int, Colour]
    source: PastSource = PastSource.DRIVE

    def at(self, t: float) -> Snapshot:
        """The snapshot, moved to a time: the ego on its arc, the agents with their velocities."""
        later = t - self.t
        if abs(later) < SAME_TIME_S:
            return self
        agents = self.agents
        x, y = agents.x + later * agents.vx, agents.y + later * agents.vy
        return replace(self, t=t, ego=self.ego.later(t), agents=replace(agents, x=x, y=y))


@dataclass(frozen=True, eq=False, slots=True)
class Past:
    """The past of a frame, oldest first: k steps of `PAST_STEP_S`, the last one step before it.

    Attributes:
        t: `(k,)` s since the scenario's start, also before it.
        ego: The state at the rear axle at each step.
        ids: n names: first those of `Frame.agents`, in that order, then those that are gone.
        kinds: Their kinds.
        length: `(n,)` m; `width` likewise.
        x: `(k, n)` centre of the box, world, m; `y` likewise; `yaw` rad; `vx`, `vy` m/s. Where an
            agent was not seen, its nearest known state, moved with its velocity.
        seen: `(k, n)` whether the agent was there.
        lights: The colour of each traffic light at each step.
        source: Where each step comes from.
    """

    t: FloatArray
    ego: tuple[EgoState, ...]
    ids: tuple[str, ...]
    kinds: tuple[AgentKind, ...]
    length: FloatArray
    width: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    vx: FloatArray
    vy: FloatArray
    seen: BoolArray
    lights: tuple[Mapping[int, Colour], ...]
    source: tuple[PastSource, ...]

    def __len__(self) -> int:
        return len(self.t)


Before = Callable[[Sequence[float]], Sequence[Snapshot]]
"""Gives the snapshots at times before the first frame of a drive, in order of time."""


def _nothing_before(times: Sequence[float]) -> Sequence[Snapshot]:
    return ()


def _times(t: float) -> list[float]:
    """The times (1), oldest first, in whole nanoseconds."""
    now_ns = round(1e9 * t)
    return [(now_ns - k * STEP_NS) / 1e9 for k in range(PAST_STEPS, 0, -1)]


def forget(snapshots: deque[Snapshot], t: float) -> None:
    """Remove the snapshots, in order of time, that no past from `t` on needs."""
    while len(snapshots) > 1 and snapshots[1].t <= t - PAST_S + SAME_TIME_S:
        snapshots.popleft()


def _fill(columns: FloatArray, seen: BoolArray, t: FloatArray) -> None:
    """Give agents that were not seen their next state, moved back, else their last one, moved on.

    `columns`: the rows `MOTION` `(5, k, n)`.
    """
    known = seen.copy()
    steps = range(len(t))
    for order in (steps[::-1], steps):
        for k, source in zip(order[1:], order[:-1], strict=True):
            rows = ~known[k] & known[source]
            columns[:, k, rows] = columns[:, source, rows]
            columns[:2, k, rows] += (t[k] - t[source]) * columns[3:, source, rows]
            known[k] |= rows


@dataclass(frozen=True, eq=False, slots=True)
class Earlier:
    """What a past is made of, when it is asked for.

    Attributes:
        snapshots: The frames of the drive in the last `PAST_S`, in order of time.
        before: Gives what was before the drive.
        offset: Is added to all their positions, m.
    """

    snapshots: Sequence[Snapshot] = ()
    before: Before = field(default=_nothing_before)
    offset: tuple[float, float] = (0.0, 0.0)

    def steps(self, now: Snapshot) -> list[Snapshot]:
        """The snapshots at the times (1), oldest first."""
        known = [*map(self._moved, self.snapshots), now]
        steps = self._before_first(now.t, known[0])
        for t in _times(now.t)[len(steps) :]:
            last = next(snapshot for snapshot in reversed(known) if snapshot.t <= t + SAME_TIME_S)
            steps.append(last.at(t))
        return steps

    def known(self, now: Snapshot) -> list[Snapshot]:
        """The steps before the first frame of the drive, oldest first, then its frames."""
        frames = list(map(self._moved, self.snapshots))
        return [*self._before_first(now.t, [*frames, now][0]), *frames]

    def _before_first(self, t: float, first: Snapshot) -> list[Snapshot]:
        """The steps before the first frame that is known: of the log, and before it held."""
        early = [time for time in _times(t) if time < first.t - SAME_TIME_S]
        before = list(map(self._moved, self.before(early)))
        begin = [*before, first][0]
        no_agents = begin.agents.some(np.empty(0, np.int64))
        unknown = replace(begin, agents=no_agents, source=PastSource.HELD)
        return [*map(unknown.at, early[: len(early) - len(before)]), *before]

    def _moved(self, snapshot: Snapshot) -> Snapshot:
        x, y = self.offset
        if not (x or y):
            return snapshot
        ego, agents = snapshot.ego, snapshot.agents
        return replace(
            snapshot,
            ego=replace(ego, x=ego.x + x, y=ego.y + y),
            agents=replace(agents, x=agents.x + x, y=agents.y + y),
        )

    def past(self, now: Snapshot) -> Past:
        """The past of a snapshot; it is made anew at each call."""
        steps = self.steps(now)
        agents = dict[str, tuple[Agents, int]]()
        for snapshot in (now, *reversed(steps)):
            for row, name in enumerate(snapshot.agents.ids):
                agents.setdefault(name, (snapshot.agents, row))
        place = {name: n for n, name in enumerate(agents)}
        columns = np.zeros((len(MOTION), len(steps) + 1, len(agents)))
        seen = np.zeros((len(steps) + 1, len(agents)), np.bool_)
        for k, snapshot in enumerate((*steps, now)):
            rows = [place[name] for name in snapshot.agents.ids]
            seen[k, rows] = True
            for column, name in zip(columns, MOTION, strict=True):
                column[k, rows] = getattr(snapshot.agents, name)
        t = np.array([snapshot.t for snapshot in (*steps, now)])
        _fill(columns, seen, t)
        last = agents.values()
        x, y, yaw, vx, vy = columns[:, :-1]
        return Past(
            t[:-1],
            tuple(snapshot.ego for snapshot in steps),
            tuple(agents),
            tuple(of_agents.kinds[row] for of_agents, row in last),
            np.array([of_agents.length[row] for of_agents, row in last]),
            np.array([of_agents.width[row] for of_agents, row in last]),
            x,
            y,
            yaw,
            vx,
            vy,
            seen[:-1],
            tuple(snapshot.lights for snapshot in steps),
            tuple(snapshot.source for snapshot in steps),
        )


NOTHING_EARLIER = Earlier()
"""What is known before the first frame of a log without a past."""
