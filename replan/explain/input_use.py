"""How each frame's plan used its agents: what perception showed against what the artefacts have.

What perception shows is made again with the settings of the loop: its delay, noise and range are
therefore no difference. Differences from the artefacts are the planner's own: its margins
(`replan.explain.input_outlines`), or a fault between the frame and the planner.

An artefact makes visible: S-T obstacles where moving agents were used, and as moving how; S-L
obstacles where agents that stand were; decisions which agents and stops were used at all; the start
of the plan, or of the S-T solution of a plan that was refused, the state that it started from.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from replan.core.arrays import FloatArray, arc_lengths
from replan.explain.course import PlanWay, Ways
from replan.explain.input_outlines import MISSED_M, SLICES, GraphLine, Slices, expected_slices
from replan.explain.planner_input import PlannerInput, planner_inputs
from replan.logs.agents import AgentKind, Agents
from replan.logs.frame import PlannerContext
from replan.logs.plan import Decision, PlanStart, PlanStatus, SlGraph, StGraph
from replan.logs.rules import RED
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.logs.trace import Trace
from replan.planners.frenet.lane_sequences import LaneSequences
from replan.planners.frenet.scene import STANDING_MPS, UNLIKELY, RouteTracker
from replan.replay.loop_config import LoopConfig
from replan.results.schema import names_of

BEYOND_M, FARTHEST_M = 15.0, 300.0
"""The way is longer by the first than the plan and its S-T obstacles, but not than the second."""
SOON = 20
"""An agent is needed if it takes the way within this many slices, before where the ego then is."""
MARGINS_M = (0.0, 0.3, 0.6)
"""Space on each side of the ego that planners may keep; the one that fits best is taken."""
OFF_M, OFF_S = 0.5, 0.15
"""An outline may be off by the first, m, and by the second at the speed of the agent, s."""
STOP_MPS2 = 3.0
"""A red light is needed if the ego can stop before its line with this deceleration."""
MOVES_MPS = 2.0
"""The start of a plan is compared where the ego is faster than this."""


@dataclass(frozen=True, eq=False, slots=True)
class UsedFrame:
    """A frame and the way of its plan.

    Attributes:
        read: What perception and its settings gave.
        ego: The ego's state.
        planned: Arc length of the plan at `SLICES`, m.
        rows: The row of each agent that was shown, by id.
    """

    read: PlannerInput
    ego: EgoState
    path: PlanWay
    planned: FloatArray
    rows: dict[str, int]


@dataclass(frozen=True, eq=False, slots=True)
class AgentUse:
    """An agent in a frame.

    Attributes:
        frame: Index of the frame; `row` that of the agent as shown.
        ahead_m: Its centre from the ego's rear axle, along the ego's heading; `left_m` across.
        named: Whether an artefact names it.
        needed: Whether a plan must know it: it is ahead, and takes the way soon.
        drawn: Its S-T outline; None if there is none.
        expected: The slices that fit best to it, of what was shown; None: it does not take the way.
        shift: How far its S-L outline is off what was shown `(2,)`, world, m; None if there is none
            or it moves.
        off_m: The difference of outlines and what was shown, m; NaN without outlines.
    """

    frame: int
    row: int
    agent: str
    kind: AgentKind
    ahead_m: float
    left_m: float
    speed: float
    named: bool
    needed: bool
    drawn: Slices | None
    expected: Slices | None
    shift: FloatArray | None
    off_m: float

    @property
    def allowed_m(self) -> float:
        """By how much its outlines may be off."""
        return OFF_M + OFF_S * self.speed

    @property
    def aside_m(self) -> float:
        """Distance of its centre from the line along the ego's heading."""
        return abs(self.left_m)

    @property
    def distance_m(self) -> float:
        """Distance from the ego's rear axle."""
        return float(np.hypot(self.ahead_m, self.left_m))


@dataclass(frozen=True, slots=True)
class LightUse:
    """A red light that the ego could stop at, and whether an artefact names its stop line."""

    frame: int
    line: str
    named: bool


@dataclass(frozen=True, slots=True)
class StartUse:
    """The start of a plan against the ego: ahead and left in the ego's frame, m, and the share of
    its speed.
    """

    frame: int
    ahead_m: float
    left_m: float
    share: float


def used_frames(
    trace: Trace, scenario: Scenario, loop: LoopConfig | None = None
) -> Iterator[UsedFrame]:
    """The frames of a drive; arguments as `planner_inputs`."""
    ways = Ways(scenario)
    for read in planner_inputs(trace, scenario, loop):
        plan = read.planned.plan
        path, own = plan.trajectory, arc_lengths(plan.trajectory.x, plan.trajectory.y)
        graphs = [item for item in plan.internals if isinstance(item, StGraph)]
        far = [
            float(obstacle.outline[:, 1].max(initial=0.0))
            for graph in graphs
            for obstacle in graph.obstacles
        ]
        reach = min(max([float(own[-1]), *far]) + BEYOND_M, FARTHEST_M)
        planned = np.interp(SLICES, path.t - path.t[0], own)
        rows = {name: row for row, name in enumerate(read.agents.ids)}
        ego = trace.ego.at(read.planned.t)
        yield UsedFrame(read, ego, ways.of(plan, reach), planned, rows)


class InputReader:
    """Reads from the artefacts of a drive's plans what they used."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario, start = scenario, scenario.ego.state(0)
        context = PlannerContext(scenario.road, scenario.goal, scenario.vehicle, 0.1, start)
        self._lanes = LaneSequences(context)
        self._route = RouteTracker(context).reference.line

    def agents(self, index: int, frame: UsedFrame) -> Iterator[AgentUse]:
        """The agents that a plan used or needed; none where it shows no S-T graph, or failed."""
        plan, shown, futures = frame.read.planned.plan, frame.read.agents, frame.read.predictions
        graphs = [item for item in plan.internals if isinstance(item, StGraph)]
        if plan.status.is_fallback or futures is None or not graphs:
            return
        named, car = names_used(frame), self._scenario.vehicle
        drawn: dict[str, list[Slices]] = {}
        for graph in graphs:
            for obstacle in graph.obstacles:
                if len(obstacle.outline) > 2:
                    slices = Slices.of(obstacle.outline)
                    drawn.setdefault(obstacle.agent, []).append(slices)
        expected: dict[int, list[Slices]] = {}
        needed = set[int]()
        for margin in MARGINS_M:
            for row, slices, probability in expected_slices(
                frame.path, shown, futures, car, margin
            ):
                expected.setdefault(row, []).append(slices)
                if margin == 0.0 and probability > UNLIKELY:
                    is_soon = bool((slices.lower[:SOON] < frame.planned[SOON]).any())
                    needed |= {row} if is_soon else set()
        shifts = self._shifts(frame)
        aheads, lefts = frame.ego.offset_of(shown.x, shown.y)
        for row, name in enumerate(shown.ids):
            if name not in named and row not in needed:
                continue
            ahead, left = float(aheads[row]), float(lefts[row])
            speed = float(np.hypot(shown.vx[row], shown.vy[row]))
            pairs = [
                (outline.difference(other, speed), outline, other)
                for outline in drawn.get(name, ())
                for other in expected.get(row, ())
            ]
            off, outline, other = min(pairs, key=lambda pair: pair[0], default=(np.nan, None, None))
            if outline is None and name in drawn:
                off, outline = MISSED_M, drawn[name][0]
            shift = shifts.get(name) if speed < STANDING_MPS else None
            if shift is not None:
                off = float(np.fmax(off, np.hypot(*shift)))
            yield AgentUse(
                index,
                row,
                name,
                shown.kinds[row],
                ahead,
                left,
                speed,
                name in named,
                row in needed and ahead > 0.0,
                outline,
                other,
                shift,
                off,
            )

    def _shifts(self, frame: UsedFrame) -> dict[str, FloatArray]:
        """The shifts of the S-L outlines of a plan, by agent."""
        plan, shown = frame.read.planned.plan, frame.read.agents
        lines = (self._lanes.start(plan.trajectory.state(0)).reference.line, self._route)
        shifts: dict[str, FloatArray] = {}
        for graph in (item for item in plan.internals if isinstance(item, SlGraph)):
            placed = (GraphLine.of(graph, plan.trajectory, line) for line in lines)
            line = next((line for line in placed if line is not None), None)
            for obstacle in graph.obstacles if line is not None else ():
                row = frame.rows.get(obstacle.agent)
                if line is not None and row is not None:
                    shifts[obstacle.agent] = line.shift(obstacle.outline, shown, row)
        return shifts

    def lights(self, index: int, frame: UsedFrame) -> Iterator[LightUse]:
        """The red lights whose line the plan crosses although the ego could stop before it."""
        named, lanes = names_used(frame), set(frame.path.lanes)
        for line in self._scenario.road.stop_lines:
            on_way = line.lane in lanes and (not line.towards or not lanes.isdisjoint(line.towards))
            if line.light is None or not on_way or frame.read.lights.get(line.light) not in RED:
                continue
            s = frame.path.crossing(line.points, self._scenario.vehicle.axle_to_front)
            if max(frame.ego.v**2 / (2.0 * STOP_MPS2), 0.5) < s < frame.planned[-1]:
                name = f"stop line {line.id}"
                yield LightUse(index, name, name in named)


@dataclass(frozen=True, eq=False, slots=True)
class InputUse:
    """What the plans of a drive used.

    Attributes:
        log: Name of the log.
        trace: The drive; `scenario` its road, vehicle and lights.
        frames: The frames of the drive, then what they used.
    """

    log: str
    trace: Trace
    scenario: Scenario
    frames: Sequence[UsedFrame]
    agents: Sequence[AgentUse]
    lights: Sequence[LightUse]
    starts: Sequence[StartUse]

    @classmethod
    def of(
        cls, trace: Trace, scenario: Scenario, loop: LoopConfig | None = None, log: str = ""
    ) -> InputUse:
        """Read the artefacts of a drive; arguments as `planner_inputs`.

        `log`: its name in a run; default: that of the trace.
        """
        frames, reader = list(used_frames(trace, scenario, loop)), InputReader(scenario)
        agents, lights, starts = list[AgentUse](), list[LightUse](), list[StartUse]()
        for index, frame in enumerate(frames):
            agents += reader.agents(index, frame)
            lights += reader.lights(index, frame)
            start = start_use(index, frame)
            starts += [] if start is None else [start]
        return cls(log or trace.scenario, trace, scenario, frames, agents, lights, starts)

    @property
    def times(self) -> list[float]:
        """The times of the frames, s."""
        return [frame.read.planned.t for frame in self.frames]

    @property
    def is_blind(self) -> bool:
        """Whether no plan has an S-T graph, without which nothing is known about agents."""
        return not any(
            isinstance(item, StGraph)
            for frame in self.frames
            for item in frame.read.planned.plan.internals
        )

    def table(self) -> pd.DataFrame:
        """A row per frame and agent, red light and start, with the columns of input_use.parquet."""
        times, truth, rows = self.times, dict[int, Agents](), list[dict[str, object]]()
        for use in self.agents:
            frame = self.frames[use.frame]
            if use.frame not in truth:
                truth[use.frame] = self.trace.agents.truth(times[use.frame])
            rows.append({"t_s": times[use.frame]} | _row(use, frame, truth[use.frame]))
        for light in self.lights:
            named = {"agent": light.line, "kind": "red light", "named": light.named}
            rows.append({"t_s": times[light.frame], "needed": True} | named)
        for start in self.starts:
            place = {"along_m": start.ahead_m, "across_m": start.left_m, "share": start.share}
            about = {"agent": "", "kind": "start", "named": True, "needed": True}
            rows.append({"t_s": times[start.frame]} | about | place)
        drive = {"log": self.log, "planner": self.trace.planner, "mode": self.trace.mode.value}
        rows = [drive | row for row in rows]
        table = pd.DataFrame(rows, columns=names_of("input_use.parquet"))
        return table.sort_values("t_s", kind="stable", ignore_index=True)


def _row(use: AgentUse, frame: UsedFrame, truth: Agents) -> dict[str, object]:
    """The columns of an agent in a frame that its outlines and its track give."""
    shown, row, ego = frame.read.agents, use.row, frame.ego
    columns: dict[str, object] = {
        "agent": use.agent,
        "kind": use.kind.value,
        "named": use.named,
        "needed": use.needed,
        "ahead_m": use.ahead_m,
        "left_m": use.left_m,
        "speed_mps": use.speed,
        "off_m": use.off_m,
        "allowed_m": use.allowed_m,
    }
    if use.agent in truth.ids:
        i = truth.ids.index(use.agent)
        off = np.array([shown.x[row] - truth.x[i], shown.y[row] - truth.y[i]])
        columns |= dict(zip(("shown_along_m", "shown_across_m"), in_ego(off, ego), strict=True))
    if use.shift is not None:
        columns |= dict(zip(("along_m", "across_m"), in_ego(use.shift, ego), strict=True))
    if use.drawn is not None and use.expected is not None:
        columns |= use.drawn.motion(use.expected)
    return columns


def in_ego(vector: FloatArray, ego: EgoState) -> tuple[float, float]:
    """A vector of the world `(2,)` along and across the ego's heading."""
    cos, sin = np.cos(ego.yaw), np.sin(ego.yaw)
    return float(cos * vector[0] + sin * vector[1]), float(cos * vector[1] - sin * vector[0])


def names_used(frame: UsedFrame) -> set[str]:
    """The agents and stops that the artefacts of a plan name."""
    named = set[str]()
    for item in frame.read.planned.plan.internals:
        if isinstance(item, (SlGraph, StGraph)):
            named |= {obstacle.agent for obstacle in item.obstacles}
        elif isinstance(item, Decision):
            named.add(item.agent)
    return named


def start_use(index: int, frame: UsedFrame) -> StartUse | None:
    """The start of a plan that begins at the ego; of a refused one, that of its S-T solution."""
    plan, ego = frame.read.planned.plan, frame.ego
    if ego.v < MOVES_MPS:
        return None
    if plan.status is PlanStatus.REFUSED:
        graphs = [item for item in plan.internals if isinstance(item, StGraph)]
        if not graphs or len(graphs[0].qp) < 3:
            return None
        t, s = graphs[0].qp[:3].T - graphs[0].qp[0][:, None]
        v = (4.0 * s[1] - s[2]) / t[2]  # at the first of three points with equal steps
        return StartUse(index, 0.0, 0.0, float(v) / ego.v)
    if plan.status.is_fallback or plan.start is not PlanStart.EGO:
        return None
    first = plan.trajectory.state(0)
    ahead, left = in_ego(np.array([first.x - ego.x, first.y - ego.y]), ego)
    return StartUse(index, ahead, left, first.v / ego.v)
