"""The first difference of two drives of one log, in the order of cause and effect.

Within a frame: input (agents, ego), predictions, start of the plan, route, lane choice, path DP
(sides and available space), path QP, S-T graph, speed DP (order of passing, and available space),
speed QP, plan; then, at the control rate, the command and the motion of the car. An earlier
difference comes before a later one. For a planner without internals it is its input or its plan.

(1) different = something differs by more than TOLERANCE,
        or in a word (the agents, a decision, a lane, an end)
(2) first     = the first value that differs by more than FINE, by time, then by `STAGES`

(2) looks closer than (1): a plan that is off by half a millimetre is the cause of a car that is off
by two, and not the other way round.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from math import inf
from operator import attrgetter

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.names import ShortNames
from replan.explain.value_changes import (
    FINE,
    TOLERANCE,
    Change,
    Changes,
    curve,
    largest,
    numbers,
    sizes,
    worded,
)
from replan.logs.plan import (
    Candidates,
    CostTerms,
    Decision,
    Graph,
    LaneOption,
    PlanStatus,
    SlGraph,
    StGraph,
)
from replan.logs.trace import Mode, PlannedFrame, Trace

SAME_TIME_S = 1e-6

STAGES = (
    "vehicle",
    "input frame",
    "prediction",
    "contract",
    "start of the plan",
    "route",
    "lane choice",
    "path DP",
    "path QP",
    "S-T graph",
    "speed DP",
    "speed QP",
    "plan",
    "controller",
    "end",
)
"""Stages in their order at one instant: earlier commands moved the car; its next command follows
the plan.

Those from route to speed QP are the graphs, lanes and decisions of `replan.logs.trace`. Stages that
a planner names itself, in its decisions, costs and candidates, come before the plan, in the order
of their first mention.
"""


@dataclass(frozen=True)
class FirstDifference:
    """The first difference of two drives.

    Attributes:
        t: Time since the start of the scenario, s.
        stage: One of `STAGES`, or a name of the planner's own.
        what: "t = 3.20 s, speed QP: station at 4 s 12.31 -> 10.02 m".
        agent: The agent that the difference is about; "" if there is none.
    """

    t: float
    stage: str
    what: str
    agent: str = ""


@dataclass(frozen=True, slots=True)
class _Difference:
    """A value that differs: the size of the difference (inf for words), its stage, and its
    description.
    """

    t: float
    stage: str
    size: float
    describe: Callable[[], str]
    agent: str = ""

    @property
    def place(self) -> tuple[float, float]:
        return self.t, STAGES.index(self.stage) if self.stage in STAGES else STAGES.index(
            "plan"
        ) - 0.5


def first_difference(one: Trace, two: Trace) -> FirstDifference | None:
    """The first difference of two drives of one log, from the first to the second; None if there is
    none (1).
    """
    n = _together(one.ego.t, two.ego.t)
    t, moved = one.ego.t[:n], "vehicle" if one.mode is Mode.CLOSED else "input frame"
    differences: list[_Difference] = []
    for name, unit in (("x", "m"), ("y", "m"), ("v", "m/s")):
        columns = getattr(one.ego, name)[:n], getattr(two.ego, name)[:n]
        differences += _rows(t, columns, ("input frame", moved), f"the ego's {name}", unit)
    if one.commands is not None and two.commands is not None:
        for name, unit in (("steer", "rad"), ("throttle", ""), ("brake", "")):
            columns = getattr(one.commands, name)[:n], getattr(two.commands, name)[:n]
            differences += _rows(
                t, columns, ("controller", "controller"), f"commanded {name}", unit
            )
    last = [float(trace.ego.t[-1]) for trace in (one, two)]
    ends = [
        f"{trace.end.value}{f': {trace.detail}' if trace.detail else ''}" for trace in (one, two)
    ]
    if abs(last[0] - last[1]) > SAME_TIME_S or ends[0] != ends[1]:
        sentence = f"{ends[0]} at {last[0]:.2f} s -> {ends[1]} at {last[1]:.2f} s"
        differences.append(_Difference(min(last), "end", inf, partial(str, sentence)))
    for of_frame in _frame_differences(one, two):
        differences += of_frame
        fine_times = [difference.t for difference in differences if difference.size > FINE]
        is_after = of_frame and fine_times and of_frame[0].t >= min(fine_times)
        if is_after and any(difference.size > TOLERANCE for difference in differences):
            break
    fine = [difference for difference in differences if difference.size > FINE]
    large = [difference for difference in differences if difference.size > TOLERANCE]
    if not large:  # (1)
        return None
    first = min(fine, key=attrgetter("place"))  # (2)
    clear = min(large, key=attrgetter("place"))
    later = ""
    if first.size <= TOLERANCE:
        later = f"; more than {TOLERANCE:g} from t = {clear.t:.2f} s on ({clear.stage})"
    sentence = f"t = {first.t:.2f} s, {first.stage}: {first.describe()}{later}"
    names = ShortNames(one.agents.ids)
    return FirstDifference(first.t, first.stage, names(sentence), first.agent)


def _rows(
    t: FloatArray,
    columns: tuple[FloatArray, FloatArray],
    stages: tuple[str, str],
    quantity: str,
    unit: str,
) -> Iterator[_Difference]:
    """The first row beyond FINE, and the first beyond TOLERANCE; `stages` of the first row, and of
    the others.
    """
    one, two = columns
    size = sizes(one, two)
    for bound in (FINE, TOLERANCE):
        if (size > bound).any():
            row = int(np.argmax(size > bound))
            describe = partial(numbers, quantity, one[row], two[row], unit)
            yield _Difference(float(t[row]), stages[row > 0], float(size[row]), describe)


def _together(one: FloatArray, two: FloatArray) -> int:
    """The number of instants at the start that are the same in both."""
    n = min(len(one), len(two))
    different = np.flatnonzero(np.abs(one[:n] - two[:n]) > SAME_TIME_S)
    return int(different[0]) if len(different) else n


# frame by frame -----------------------------------------------------------------------------------


def _frame_differences(one: Trace, two: Trace) -> Iterator[list[_Difference]]:
    """The differences of each frame, up to the end of the drive that ends first."""
    end = min(float(trace.ego.t[-1]) for trace in (one, two)) + SAME_TIME_S
    frames = [
        {round(f.t / SAME_TIME_S): f for f in trace.frames if f.t <= end} for trace in (one, two)
    ]
    insides = [
        [item for frame in trace.frames for item in frame.plan.internals] for trace in (one, two)
    ]
    common_kinds: set[type] = {
        kind
        for kind in (SlGraph, StGraph)
        if all(any(isinstance(item, kind) for item in items) for items in insides)
    }
    for key in sorted(frames[0].keys() | frames[1].keys()):
        before, after = (side.get(key) for side in frames)
        if before is None or after is None:
            t, drive = key * SAME_TIME_S, "second" if before is None else "first"
            yield [
                _Difference(
                    t,
                    "input frame",
                    inf,
                    partial(str, f"a plan was made in the {drive} drive only"),
                )
            ]
        else:
            yield [
                _Difference(before.t, stage, *change)
                for stage, differences in (
                    ("input frame", _others(one, two, before, after)),
                    ("prediction", _prediction_differences(before, after)),
                    ("contract", _refusal(before, after)),
                    ("start of the plan", _start_differences(before, after)),
                    *_inside(before, after, common_kinds, (one, two)),
                    ("plan", _plan_differences(before, after)),
                )
                for change in differences
            ]


@dataclass(frozen=True)
class _Members:
    """The agents that a frame lists: those of its input, or the obstacles of its graph.

    Whoever one drive lists at `t` and the other does not may be listed there later.
    """

    noun: str
    traces: tuple[Trace, Trace]
    t: float
    graph: type[Graph] | None = None  # None: the input

    def difference(self, before: Sequence[str], after: Sequence[str]) -> Change:
        """The agents that only one drive lists, and when the other one does."""
        pairs = ((before, after), (after, before))
        removed, added = ([name for name in a if name not in b] for a, b in pairs)
        return Change(inf, partial(self._sentence, removed, added), [*removed, *added, ""][0])

    def _sentence(self, removed: list[str], added: list[str]) -> str:
        parts = []
        for names, trace, words, never in (
            (removed, self.traces[1], "later", "is gone, now and in all later plans"),
            (added, self.traces[0], "earlier", "is new: in no later plan of the first drive"),
        ):
            for name in names[:3]:
                t = next((f.t for f in trace.frames if f.t > self.t and name in self._of(f)), None)
                comes = "" if t is None else f"comes {t - self.t:.2f} s {words} (t = {t:.2f} s)"
                parts.append(f"{name} {comes or never}")
            parts += [f"{len(names) - 3} more"] if len(names) > 3 else []
        return f"{self.noun}: {'; '.join(parts) or 'in another order or number'}"

    def _of(self, frame: PlannedFrame) -> Iterator[str]:
        graphs = [item for item in frame.plan.internals if self.graph and type(item) is self.graph]
        listed = (obstacle.agent for graph in graphs for obstacle in graph.obstacles)
        return iter(frame.agents) if self.graph is None else listed


def _others(one: Trace, two: Trace, before: PlannedFrame, after: PlannedFrame) -> Changes:
    """Differences of the agents that were shown to the planner, and of their states."""
    has_predictions = (
        before.predictions is not None and after.predictions is not None
    )  # else an older trace
    if has_predictions and set(before.agents) != set(after.agents):
        yield _Members("agents", (one, two), before.t).difference(before.agents, after.agents)
        return
    tracks_of = [
        trace.agents if trace.perceived is None else trace.perceived for trace in (one, two)
    ]
    shown = [tracks.perceived(before.t) for tracks in tracks_of]
    if set(shown[0].ids) != set(shown[1].ids):
        members = _Members("agents", (one, two), before.t)
        yield members.difference(shown[0].ids, shown[1].ids)
        return
    row = {name: i for i, name in enumerate(shown[1].ids)}
    order = [row[name] for name in shown[0].ids]
    for name, unit in (
        ("x", "m"),
        ("y", "m"),
        ("yaw", "rad"),
        ("vx", "m/s"),
        ("vy", "m/s"),
        ("length", "m"),
    ):
        labels = [f"{name} of {agent}" for agent in shown[0].ids]
        states = getattr(shown[0], name), getattr(shown[1], name)[order]
        yield from largest(*states, labels.__getitem__, unit, shown[0].ids)


def _prediction_differences(before: PlannedFrame, after: PlannedFrame) -> Changes:
    old, new = before.predictions, after.predictions
    if old is None or new is None or old.t.shape != new.t.shape:
        return
    names = [
        tuple(frame.agents[i] for i in predictions.agent)
        for frame, predictions in ((before, old), (after, new))
    ]
    if names[0] != names[1]:
        counts = [f"{len(hypotheses)} of {len(set(hypotheses))} agents" for hypotheses in names]
        yield worded(f"hypotheses: {counts[0]} -> {counts[1]}, or in another order")
        return
    yield from largest(
        old.probability, new.probability, lambda i: f"probability of {names[0][i]}", "", names[0]
    )
    agents = np.repeat(names[0], len(old.t))
    for name in ("x", "y"):
        one, two = getattr(old, name), getattr(new, name)
        labels = [f"{name} of {agent} in {t - before.t:g} s" for agent in names[0] for t in old.t]
        yield from largest(one.ravel(), two.ravel(), labels.__getitem__, "m", agents)


def _refusal(before: PlannedFrame, after: PlannedFrame) -> Changes:
    """Whether only one of two plans was refused; the reason says more than what led to it."""
    plans = before.plan, after.plan
    refused = [plan for plan in plans if plan.status is PlanStatus.REFUSED]
    if len(refused) == 1:
        words = ["refused" if plan in refused else "not refused" for plan in plans]
        yield worded(f"{' -> '.join(words)}: {refused[0].reason}")


def _start_differences(before: PlannedFrame, after: PlannedFrame) -> Changes:
    """Differences of the states in which the plans start, which a planner takes from its input.

    Those of a fallback follow from it. Less than TOLERANCE may be a solver's.
    """
    old, new = before.plan, after.plan
    if old.status is not new.status:
        return
    if old.start is not new.start:
        yield worded(f"{old.start.value} -> {new.start.value}")
    for name, unit in (("x", "m"), ("y", "m"), ("v", "m/s")):
        states = [getattr(plan.trajectory, name)[:1] for plan in (old, new)]
        for change in largest(states[0], states[1], [name].__getitem__, unit):
            if change.size > TOLERANCE:
                yield change


def _plan_differences(before: PlannedFrame, after: PlannedFrame) -> Changes:
    old, new = before.plan, after.plan
    if old.status is not new.status:
        reason = f" ({new.reason})" if new.reason else ""
        yield worded(f"{old.status.value} -> {new.status.value}{reason}")
    if _together(old.trajectory.t, new.trajectory.t) < max(
        len(old.trajectory), len(new.trajectory)
    ):
        counts = f"{len(old.trajectory)} -> {len(new.trajectory)}"
        yield worded(f"{counts} states, or at other times")
        return
    for name, unit in (("x", "m"), ("y", "m"), ("v", "m/s")):
        labels = [f"{name} in {t - before.t:g} s" for t in old.trajectory.t]
        yield from largest(
            getattr(old.trajectory, name), getattr(new.trajectory, name), labels.__getitem__, unit
        )


# inside a planner ---------------------------------------------------------------------------------


def _inside(
    before: PlannedFrame, after: PlannedFrame, common_kinds: set[type], traces: tuple[Trace, Trace]
) -> Iterator[tuple[str, Changes]]:
    """Differences of stage artefacts, if both plans have some; `common_kinds`: the kinds of graphs
    that both traces have.
    """
    one, two = tuple(before.plan.internals), tuple(after.plan.internals)
    if not one or not two:
        return
    choices = [
        [option.name for option in side if isinstance(option, LaneOption) and not option.against]
        for side in (one, two)
    ]
    if choices[0] and choices[1] and choices[0] != choices[1]:
        costs = "; ".join(
            f"{option.name} {option.cost:.2f} s{f' ({option.against})' if option.against else ''}"
            for option in two
            if isinstance(option, LaneOption)
        )
        yield (
            "lane choice",
            iter([worded(f"{choices[0][0]} -> {choices[1][0]} (now {costs})")]),
        )
    paths = _graphs(one, two, SlGraph)
    if paths is not None:
        ends = [graph.corridor.first[:1] for graph in paths if graph.corridor is not None]
        # With the same inputs: another reference line
        if len(ends) == 2 and len(ends[0]) and len(ends[1]):
            yield "route", largest(ends[0], ends[1], lambda i: "station of the ego", "m")
        yield "path DP", _outlines(*paths, _Members("obstacles", traces, before.t, SlGraph))
        yield "path DP", _room(*paths, "lateral offset", "station {:g} m")
        yield "path QP", curve(paths[0].qp, paths[1].qp, "lateral offset", "station {:g} m")
    yield "path DP", _decision_differences(one, two, "path")
    speeds = _graphs(one, two, StGraph)
    if speeds is not None:
        yield "S-T graph", _outlines(*speeds, _Members("obstacles", traces, before.t, StGraph))
        yield "speed DP", _room(*speeds, "station", "{:g} s")
        yield "speed QP", curve(speeds[0].qp, speeds[1].qp, "station", "{:g} s")
    yield "speed DP", _decision_differences(one, two, "speed")
    for kind, stage in ((SlGraph, "path QP"), (StGraph, "speed QP")):
        has_graph = [any(isinstance(item, kind) for item in items) for items in (one, two)]
        if kind in common_kinds and has_graph[0] != has_graph[1]:
            yield stage, iter([worded("solved now" if has_graph[1] else "no longer solved")])
    named = [
        item.stage for item in (*one, *two) if isinstance(item, Decision | CostTerms | Candidates)
    ]
    for stage in dict.fromkeys(name for name in named if name not in ("path", "speed", *STAGES)):
        yield (
            stage,
            chain(_decision_differences(one, two, stage), _count_differences(one, two, stage)),
        )


def _graphs(
    one: Sequence[object], two: Sequence[object], kind: type[Graph]
) -> tuple[Graph, Graph] | None:
    graphs = [
        next((item for item in items if isinstance(item, kind)), None) for items in (one, two)
    ]
    return (graphs[0], graphs[1]) if graphs[0] is not None and graphs[1] is not None else None


def _room(one: Graph, two: Graph, value: str, abscissa: str) -> Changes:
    """Differences of the decisions, of the choice of the DP, and of the available space."""
    sides = [{item.agent: item.decision.value for item in graph.obstacles} for graph in (one, two)]
    # In their order, which a set does not have
    for agent in (name for name in sides[0] if name in sides[1]):
        if sides[0][agent] != sides[1][agent]:
            yield worded(f"{agent}: {sides[0][agent]} -> {sides[1][agent]}", agent)
    yield from curve(one.dp, two.dp, f"{value} of the DP", abscissa)
    if one.corridor is not None and two.corridor is not None:
        for name in ("lower", "upper"):
            columns = [
                np.column_stack([c.first, getattr(c, name)]) for c in (one.corridor, two.corridor)
            ]
            yield from curve(columns[0], columns[1], f"{name} bound", abscissa)


AXES: dict[type[Graph], tuple[tuple[str, str], tuple[str, str]]] = {
    SlGraph: (("station", "m"), ("lateral offset", "m")),
    StGraph: (("time ahead", "s"), ("station", "m")),
}
"""Names and units of the axes of a graph."""


def _outlines(one: Graph, two: Graph, members: _Members) -> Changes:
    """Differences of the obstacles of a graph, and of their outlines."""
    names = [tuple(item.agent for item in graph.obstacles) for graph in (one, two)]
    if names[0] != names[1]:
        yield members.difference(names[0], names[1])
        return
    axes = AXES[type(one)]
    axis, unit = axes[0]
    for old, new in zip(one.obstacles, two.obstacles, strict=True):
        if old.outline.shape != new.outline.shape:
            spans = [_span(item.outline[:, 0]) for item in (old, new)]
            yield worded(f"outline of {old.agent}: {axis} {' -> '.join(spans)} {unit}", old.agent)
            continue
        for column, (name, of_name) in enumerate(axes):
            labels = [
                f"outline of {old.agent}, corner at {axis} {x:.4g} {unit}: {name}"
                for x in old.outline[:, 0]
            ]
            columns = old.outline[:, column], new.outline[:, column]
            yield from largest(*columns, labels.__getitem__, of_name, [old.agent] * len(labels))


def _span(values: FloatArray) -> str:
    return f"{values.min():.4g} to {values.max():.4g}" if len(values) else "none"


def _decision_differences(one: Sequence[object], two: Sequence[object], stage: str) -> Changes:
    decided = [
        {
            item.agent: item.kind.value
            for item in side
            if isinstance(item, Decision) and item.stage == stage
        }
        for side in (one, two)
    ]
    for agent in dict.fromkeys([*decided[0], *decided[1]]):
        before, after = (side.get(agent, "no decision") for side in decided)
        if before != after:
            yield worded(f"{agent}: {before} -> {after}", agent)


def _count_differences(one: Sequence[object], two: Sequence[object], stage: str) -> Changes:
    """Differences of the costs and the candidates of a stage, if both plans have them."""
    counts = []
    for side in (one, two):
        values: dict[str, float] = {}
        for item in side:
            if isinstance(item, CostTerms) and item.stage == stage:
                values |= {f"cost of {name}": cost for name, cost in item.terms}
            elif isinstance(item, Candidates) and item.stage == stage:
                rejected = item.rejected
                values |= {f"candidates rejected, {name}": float(n) for name, n in rejected}
        counts.append(values)
    names = [name for name in counts[0] if name in counts[1]]
    columns = [np.array([side[name] for name in names], np.float64) for side in counts]
    yield from largest(columns[0], columns[1], names.__getitem__, "")
