"""The first difference of two drives of one log, in the order of cause and effect; when two
planners part.

Within a frame: input (agents, ego), predictions, route, lane choice, path DP (sides and available
space), path QP, S-T graph, speed DP (order of passing, and available space), speed QP, plan; then,
at the control rate, the command and the motion of the car. An earlier difference comes before a
later one. For a planner without internals it is its input or its plan.

(1) different = something differs by more than TOLERANCE,
        or in a word (the agents, a decision, a lane, an end)
(2) first     = the first value that differs by more than FINE, by time, then by `STAGES`

(2) looks closer than (1): a plan that is off by half a millimetre is the cause of a car that is off
by two, and not the other way round.

Two planners differ in some number from the first frame on. They part at the first time at which
their drives (in open loop: their plans, AHEAD_S after each frame) differ enough to matter:

(3) parted = the speeds differ by more than PARTED_MPS,
        or the places by more than PARTED_M across the first one's way
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from math import inf, log10
from operator import attrgetter

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.names import ShortNames
from replan.explain.explanation import LONGITUDINAL
from replan.logs.plan import (
    Candidates,
    CostTerms,
    Decision,
    DecisionKind,
    Graph,
    LaneOption,
    Plan,
    SlGraph,
    StGraph,
)
from replan.logs.trace import Mode, PlannedFrame, Trace

TOLERANCE = 1e-3
"""Tolerance in m, rad, m/s, and pedal positions, 0 to 1: a millimetre is less than any metric
resolves.
"""
FINE = 1e-8
"""In the same units.

Just above rounding (1e-9 m in the grid of a city), so that causes are separated from effects.
"""
SAME_TIME_S = 1e-6

STAGES = (
    "vehicle",
    "input frame",
    "prediction",
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
    """

    t: float
    stage: str
    what: str


@dataclass(frozen=True, slots=True)
class _Difference:
    """A value that differs: the size of the difference (inf for words), its stage, and its
    description.
    """

    t: float
    stage: str
    size: float
    describe: Callable[[], str]

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
    return FirstDifference(first.t, first.stage, ShortNames(one.agents.ids)(sentence))


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
    size = _sizes(one, two)
    for bound in (FINE, TOLERANCE):
        if (size > bound).any():
            row = int(np.argmax(size > bound))
            describe = partial(_numbers, quantity, one[row], two[row], unit)
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
                _Difference(before.t, stage, size, describe)
                for stage, differences in (
                    ("input frame", _others(one, two, before, after)),
                    ("prediction", _prediction_differences(before, after)),
                    *_inside(before, after, common_kinds),
                    ("plan", _plan_differences(before, after)),
                )
                for size, describe in differences
            ]


_Found = Iterator[tuple[float, Callable[[], str]]]


def _others(one: Trace, two: Trace, before: PlannedFrame, after: PlannedFrame) -> _Found:
    """Differences of the agents that were shown to the planner, and of their states."""
    has_predictions = (
        before.predictions is not None and after.predictions is not None
    )  # else an older trace
    if has_predictions and set(before.agents) != set(after.agents):
        yield inf, partial(_words, "agents", before.agents, after.agents)
        return
    tracks_of = [
        trace.agents if trace.perceived is None else trace.perceived for trace in (one, two)
    ]
    shown = [tracks.perceived(before.t) for tracks in tracks_of]
    if set(shown[0].ids) != set(shown[1].ids):
        yield inf, partial(_words, "agents", shown[0].ids, shown[1].ids)
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
        yield from _largest(
            getattr(shown[0], name), getattr(shown[1], name)[order], labels.__getitem__, unit
        )


def _prediction_differences(before: PlannedFrame, after: PlannedFrame) -> _Found:
    old, new = before.predictions, after.predictions
    if old is None or new is None or old.t.shape != new.t.shape:
        return
    names = [
        tuple(frame.agents[i] for i in predictions.agent)
        for frame, predictions in ((before, old), (after, new))
    ]
    if names[0] != names[1]:
        yield inf, partial(_words, "hypotheses", names[0], names[1])
        return
    yield from _largest(
        old.probability, new.probability, lambda i: f"probability of {names[0][i]}", ""
    )
    for name in ("x", "y"):
        one, two = getattr(old, name), getattr(new, name)
        labels = [f"{name} of {agent} in {t - before.t:g} s" for agent in names[0] for t in old.t]
        yield from _largest(one.ravel(), two.ravel(), labels.__getitem__, "m")


def _plan_differences(before: PlannedFrame, after: PlannedFrame) -> _Found:
    old, new = before.plan, after.plan
    for name in ("status", "start"):
        words = (getattr(old, name).value, getattr(new, name).value)
        if words[0] != words[1]:
            yield (
                inf,
                partial(str, f"{words[0]} -> {words[1]}{f' ({new.reason})' if new.reason else ''}"),
            )
    if _together(old.trajectory.t, new.trajectory.t) < max(
        len(old.trajectory), len(new.trajectory)
    ):
        yield (
            inf,
            partial(
                str, f"{len(old.trajectory)} -> {len(new.trajectory)} states, or at other times"
            ),
        )
        return
    for name, unit in (("x", "m"), ("y", "m"), ("v", "m/s")):
        labels = [f"{name} in {t - before.t:g} s" for t in old.trajectory.t]
        yield from _largest(
            getattr(old.trajectory, name), getattr(new.trajectory, name), labels.__getitem__, unit
        )


# inside a planner ---------------------------------------------------------------------------------


def _inside(
    before: PlannedFrame, after: PlannedFrame, common_kinds: set[type]
) -> Iterator[tuple[str, _Found]]:
    """Differences of stage artefacts, if both plans have some; `kept`: the kinds of graphs that
    both traces have.
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
            iter([(inf, partial(str, f"{choices[0][0]} -> {choices[1][0]} (now {costs})"))]),
        )
    paths = _graphs(one, two, SlGraph)
    if paths is not None:
        ends = [graph.corridor.first[:1] for graph in paths if graph.corridor is not None]
        # With the same inputs: another reference line
        if len(ends) == 2 and len(ends[0]) and len(ends[1]):
            yield "route", _largest(ends[0], ends[1], lambda i: "station of the ego", "m")
        yield "path DP", _room(*paths, "lateral offset", "station {:g} m", moves=False)
        yield "path QP", _curve(paths[0].qp, paths[1].qp, "lateral offset", "station {:g} m")
    yield "path DP", _decision_differences(one, two, "path")
    speeds = _graphs(one, two, StGraph)
    if speeds is not None:
        yield "S-T graph", _outlines(*speeds)
        yield "speed DP", _room(*speeds, "station", "{:g} s", moves=True)
        yield "speed QP", _curve(speeds[0].qp, speeds[1].qp, "station", "{:g} s")
    yield "speed DP", _decision_differences(one, two, "speed")
    for kind, stage in ((SlGraph, "path QP"), (StGraph, "speed QP")):
        has_graph = [any(isinstance(item, kind) for item in items) for items in (one, two)]
        if kind in common_kinds and has_graph[0] != has_graph[1]:
            yield (
                stage,
                iter([(inf, partial(str, "solved now" if has_graph[1] else "no longer solved"))]),
            )
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


def _room(one: Graph, two: Graph, value: str, abscissa: str, *, moves: bool) -> _Found:
    """Differences of the obstacles (`moves=False` only), of the choice of the DP, and of the
    available space.
    """
    if not moves:
        yield from _outlines(one, two)
    sides = [{item.agent: item.decision.value for item in graph.obstacles} for graph in (one, two)]
    # In their order, which a set does not have
    for agent in (name for name in sides[0] if name in sides[1]):
        if sides[0][agent] != sides[1][agent]:
            yield inf, partial(str, f"{agent}: {sides[0][agent]} -> {sides[1][agent]}")
    yield from _curve(one.dp, two.dp, f"{value} of the DP", abscissa)
    if one.corridor is not None and two.corridor is not None:
        for name in ("lower", "upper"):
            columns = [
                np.column_stack([c.first, getattr(c, name)]) for c in (one.corridor, two.corridor)
            ]
            yield from _curve(columns[0], columns[1], f"{name} bound", abscissa)


def _outlines(one: Graph, two: Graph) -> _Found:
    """Differences of the obstacles of a graph, and of their outlines."""
    names = [tuple(item.agent for item in graph.obstacles) for graph in (one, two)]
    if names[0] != names[1]:
        yield inf, partial(_words, "obstacles", names[0], names[1])
        return
    for old, new in zip(one.obstacles, two.obstacles, strict=True):
        if old.outline.shape != new.outline.shape:
            yield inf, partial(str, f"{old.agent} occupies the path at other times")
        else:
            labels = [f"outline of {old.agent}"] * old.outline.size
            yield from _largest(old.outline.ravel(), new.outline.ravel(), labels.__getitem__, "")


def _decision_differences(one: Sequence[object], two: Sequence[object], stage: str) -> _Found:
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
            yield inf, partial(str, f"{agent}: {before} -> {after}")


def _count_differences(one: Sequence[object], two: Sequence[object], stage: str) -> _Found:
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
    yield from _largest(columns[0], columns[1], names.__getitem__, "")


# numbers and words --------------------------------------------------------------------------------


def _sizes(one: FloatArray, two: FloatArray) -> FloatArray:
    """Absolute differences `(n,)`; inf if only one value is a number."""
    same: BoolArray = (one == two) | (np.isnan(one) & np.isnan(two))
    with np.errstate(invalid="ignore"):
        sizes = np.abs(two - one)
    return np.where(same, 0.0, np.where(np.isnan(sizes), inf, sizes))


def _largest(one: FloatArray, two: FloatArray, label_of: Callable[[int], str], unit: str) -> _Found:
    if len(one) != len(two):
        yield inf, partial(str, f"{len(one)} -> {len(two)} values")
    elif len(one):
        size = _sizes(one, two)
        row = int(np.argmax(size))
        if size[row] > FINE:
            yield float(size[row]), lambda: _numbers(label_of(row), one[row], two[row], unit)


def _curve(one: FloatArray, two: FloatArray, value: str, abscissa: str) -> _Found:
    """Curves `(n, 2)` of a value, m, over a time or station, formatted by `at`: where both exist,
    then their ends.
    """
    if not len(one) or not len(two):
        if len(one) != len(two):
            yield inf, partial(str, f"{value}: {'none' if len(two) == 0 else 'there now'}")
        return
    if one.shape == two.shape:
        x, before, after = one[:, 0], one[:, 1], two[:, 1]
    else:
        x = one[(one[:, 0] >= two[0, 0]) & (one[:, 0] <= two[-1, 0]), 0]
        before, after = (np.interp(x, *curve.T) for curve in (one, two))
    differences = list(
        _largest(
            before, after, lambda i: f"{value} at {abscissa.format(float(f'{x[i]:.4g}'))}", "m"
        )
    )
    yield from differences
    if one.shape != two.shape and not any(size > TOLERANCE for size, _ in differences):
        ends = " -> ".join(abscissa.format(float(f"{curve[-1, 0]:.4g}")) for curve in (one, two))
        yield inf, partial(str, f"{value} ends at {ends}")


def _numbers(quantity: str, one: float, two: float, unit: str) -> str:
    """Both values with as many digits as show that they differ."""
    size = abs(two - one)
    digits = int(np.clip(1 - np.floor(log10(size)), 2, 9)) if 0.0 < size < inf else 2
    return f"{quantity} {one:.{digits}f} -> {two:.{digits}f}{f' {unit}' if unit else ''}"


def _words(noun: str, one: Sequence[str], two: Sequence[str]) -> str:
    """The names that were added and removed."""
    added, removed = ([name for name in a if name not in b] for a, b in ((two, one), (one, two)))
    parts = [
        f"{word} {', '.join(names[:3])}{' ...' if len(names) > 3 else ''}"
        for word, names in (("no longer", removed), ("now also", added))
        if names
    ]
    return f"{noun}: {'; '.join(parts) or 'in another order or number'}"


PARTED_MPS, PARTED_M, AHEAD_S = 1.0, 0.5, 3.0
LATERAL = (DecisionKind.NUDGE_LEFT, DecisionKind.NUDGE_RIGHT)


def planners_part(one: Trace, two: Trace) -> FirstDifference | None:
    """The first time at which two planners part (3), with the decision of each; None if they never
    do.
    """
    for old, new in zip(one.frames, two.frames, strict=False):
        t, states = old.t, []
        for trace, frame in ((one, old), (two, new)):
            planned = frame.plan.trajectory
            t_ahead = min(frame.t + AHEAD_S, float(planned.t[-1]))
            states.append(trace.ego.at(t) if trace.mode is Mode.CLOSED else planned.at(t_ahead))
        first, second = states
        across = (second.y - first.y) * np.cos(first.yaw) - (second.x - first.x) * np.sin(first.yaw)
        if abs(first.v - second.v) > PARTED_MPS or abs(across) > PARTED_M:  # (3)
            instant = (
                f"t = {t:.2f} s" if one.mode is Mode.CLOSED else f"t = {t:.2f} s, in {AHEAD_S:g} s"
            )
            side = f", {abs(across):.1f} m to the {'left' if across > 0.0 else 'right'}"
            before, after = (
                f"{state.v:.1f} m/s ({decided(frame_of_side.plan)})"
                for state, frame_of_side in zip(states, (old, new), strict=True)
            )
            sentence = f"{instant}: {before} -> {after}{side if abs(across) > PARTED_M else ''}"
            return FirstDifference(t, "plan", ShortNames(one.agents.ids)(sentence))
    return None


def decided(plan: Plan) -> str:
    """The strongest decision of a plan about the speed, else about the side, with its agent."""
    decisions = [item for item in plan.internals if isinstance(item, Decision)]
    for kind in (*LONGITUDINAL, *LATERAL):
        agents = list(dict.fromkeys(item.agent for item in decisions if item.kind is kind))
        if agents:
            return (
                f"{kind.value} "
                f"{agents[0]}{f' and {len(agents) - 1} more' if len(agents) > 1 else ''}"
            )
    return plan.status.value if plan.status.is_fallback else "nothing decided"
