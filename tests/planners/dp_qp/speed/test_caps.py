"""Speed caps: the limit is their minimum, a new case is one producer.

What both orders of passing cost.
"""

import re
from dataclasses import replace
from math import inf

import numpy as np
import pytest
from cap_views import view
from followed import followed
from hypothesis import given, strategies as st
from roads import along_x, lanes
from scenes import CAR, Other, path_of, reference, scene

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.catalogue import scenario
from replan.logs.frame import Visibility
from replan.logs.plan import Decision, DecisionKind, StGraph
from replan.logs.states import EgoState
from replan.planners.dp_qp.path.passing import free_stations, pass_targets
from replan.planners.dp_qp.speed import stage
from replan.planners.dp_qp.speed.caps import (
    OTHERS,
    WORTH_MPS,
    LoweredLimit,
    PathView,
    SpeedCap,
    lower_limit,
    passing_caps,
)
from replan.replay.loop.closed_loop import run_closed_loop

SIGMA = np.arange(0.0, 60.0, 0.5)
SPEEDS, STATIONS = st.sampled_from([0.0, 2.5, 4.0, 6.5, 9.0, 20.0]), st.floats(-5.0, 65.0)


@st.composite
def speed_caps(draw: st.DrawFn) -> SpeedCap:
    begin, agent, v = draw(STATIONS), draw(st.sampled_from(["", "a", "b", "c"])), draw(SPEEDS)
    end = draw(st.sampled_from([inf, begin + 1.0, begin + 20.0]))
    return SpeedCap(
        draw(st.sampled_from([-inf, begin])), end, v, agent, f"{v:.1f} m/s", draw(st.booleans())
    )


CAPS = st.lists(speed_caps(), max_size=6)
ROADS = st.lists(st.floats(3.0, 16.0), min_size=2, max_size=5)


def road_of(values: list[float]) -> LoweredLimit:
    v = np.interp(SIGMA, np.linspace(0.0, 60.0, len(values)), values)
    return LoweredLimit(v, np.zeros(len(SIGMA), np.bool_))


def there(cap: SpeedCap) -> np.ndarray:
    return (cap.s_from < SIGMA) & (cap.s_to >= SIGMA)


@given(ROADS, CAPS)
def test_the_limit_is_the_least_of_road_and_caps_there(
    values: list[float], caps: list[SpeedCap]
) -> None:
    road = road_of(values)
    found = lower_limit(SIGMA, road, caps)
    least = np.min([road.v, *(np.where(there(cap), cap.v, inf) for cap in caps)], axis=0)
    np.testing.assert_array_equal(found.v, least)
    bound = np.any(
        [there(cap) & (cap.v == least) & cap.is_bound for cap in caps] or [road.is_bound], axis=0
    )
    np.testing.assert_array_equal(found.is_bound, bound)


@given(ROADS, CAPS, st.randoms(use_true_random=False))
def test_the_order_of_the_caps_does_not_matter(
    values: list[float], caps: list[SpeedCap], shuffled: object
) -> None:
    road, others = road_of(values), caps.copy()
    shuffled.shuffle(others)  # type: ignore[attr-defined]
    one, two = lower_limit(SIGMA, road, caps), lower_limit(SIGMA, road, others)
    np.testing.assert_array_equal(one.v, two.v)
    np.testing.assert_array_equal(one.is_bound, two.is_bound)
    assert {(item.agent, item.reason) for item in one.decisions} == {
        (item.agent, item.reason) for item in two.decisions
    }


@given(ROADS, CAPS)
def test_each_agent_that_lowers_the_limit_has_one_decision_with_its_lowest_speed(
    values: list[float], caps: list[SpeedCap]
) -> None:
    road = road_of(values)
    worth = [cap for cap in caps if cap.agent and (cap.v < road.v - WORTH_MPS)[there(cap)].any()]
    found = lower_limit(SIGMA, road, caps).decisions
    assert {item.agent for item in found} == {cap.agent for cap in worth} and len(found) == len(
        {c.agent for c in worth}
    )
    for item in found:
        assert item.reason == f"{min(cap.v for cap in worth if cap.agent == item.agent):.1f} m/s"
        assert (item.kind, item.stage) == (DecisionKind.YIELD, "speed")


@given(ROADS, CAPS)
def test_earlier_decisions_are_kept(values: list[float], caps: list[SpeedCap]) -> None:
    before = Decision("it", DecisionKind.STOP, "speed", "red light")
    road = road_of(values)
    found = lower_limit(SIGMA, LoweredLimit(road.v, road.is_bound, (before,)), caps)
    assert found.decisions[0] == before
    assert (road.v == road_of(values).v).all() and not road.is_bound.any()


EGO = EgoState(0.0, 20.0, 0.0, 0.0, 10.0)
COURSE = reference(lanes(along_x(0.0, 400.0)), ego=EGO)
X = 0.5 * np.arange(200)


def seen(d: float, ahead: float, kind: AgentKind) -> PathView:
    """Hidden ground, an agent who came to the path, and one who goes along the lane, `d` m beside
    the ego.
    """
    side, x = 0.5 * CAR.width + d, EGO.x + ahead
    corners = np.array([[x, side], [x + 20.0, side], [x + 20.0, side + 5.0], [x, side + 5.0]])
    sight = Visibility(EGO.x, 0.0, 0.0, 100.0, 2.0 * np.pi, corners[None])
    came = Other("came", lambda t: (x, -side - 0.25, 0.0, 0.0, 0.0), AgentKind.PEDESTRIAN, 0.5, 0.5)
    goes = Other("goes", lambda t: (x + 1.3 * t, side + 0.25, 0.0, 1.3, 0.0), kind, 0.5, 0.5)
    now = scene(COURSE, EGO, [came, goes], seen=sight)
    targets = pass_targets(now, [1], free_stations(now.frame.predictions.t, now.s, 10.0, 10.0))
    path = path_of(np.zeros(len(X)), 0.5)
    moved = type(path)(path.sigma, path.x + EGO.x, path.y, path.yaw, path.kappa, path.s + now.s)
    return view(now, moved, targets=targets, came={"came": 0.0})


@given(st.floats(0.2, 0.49), st.floats(0.0, 0.2))
def test_a_pedestrian_nearer_to_the_path_is_passed_more_slowly(d: float, more: float) -> None:
    looked = seen(1.0, 20.0, AgentKind.PEDESTRIAN)
    tasks = (replace(looked.task, targets=(), passed={"came": room}) for room in (d, d + more))
    found, further = (passing_caps(replace(looked, task=task)) for task in tasks)
    (cap,) = found
    assert cap.v == pytest.approx(15.0 * max(d / 0.5, 0.6)) and cap.agent == "came"
    assert cap.s_from < 20.0 - CAR.axle_to_front < 20.0 < cap.s_to
    assert all(cap.v <= other.v <= 15.0 for other in further) and bool(further) is (d + more < 0.5)


def speeds(drive: list) -> tuple[FloatArray, FloatArray]:
    """Front bumper and speed of the ego at each frame."""
    return tuple(np.array([(now.ego.x + CAR.axle_to_front, now.ego.v) for now, _ in drive]).T)  # type: ignore[return-value]


BEGIN, END, SLOW = 60.0, 80.0, 5.0


def school(seen: PathView) -> tuple[SpeedCap, ...]:
    """A new special case: children may be about beside a school."""
    front = seen.scene.front + seen.path.sigma[0]
    # The road of the test begins at x = -50
    begin, end = (station - front + 50.0 for station in (BEGIN, END))
    return (SpeedCap(begin, end, SLOW, "school", f"children may be about: {SLOW:.1f} m/s"),)


def test_a_new_special_case_is_one_producer_and_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is driven, kept exactly, and said; nothing else knows of it."""
    road, ego = lanes(along_x()), EgoState(0.0, 0.0, 0.0, 0.0, 10.0)
    x, v = speeds(followed(road, ego, seconds=14.0))
    assert v[(x > BEGIN) & (x < END)].min() > 9.0
    monkeypatch.setattr(stage, "OTHERS", (*OTHERS, school))
    drive = followed(road, ego, seconds=14.0)
    x, v = speeds(drive)
    inside = (x > BEGIN + 0.5) & (x < END)
    assert inside.any() and v[inside].max() <= SLOW + 0.02 and v[inside].min() > SLOW - 0.5
    assert v[x < BEGIN - 30.0].min() > 9.0 and v[-1] > SLOW + 3.0
    said = [
        item
        for item in drive[0][1].internals
        if isinstance(item, Decision) and item.agent == "school"
    ]
    assert [item.reason for item in said] == ["children may be about: 5.0 m/s"]
    past = drive[-1][1].internals
    assert not [item for item in past if isinstance(item, Decision) and item.agent == "school"]


SAID = re.compile(
    r"(?:keeps (-?[\d.]+) m, )?(yielding|going first) (.+?), (yielding|going first) (.+)$"
)
WORDS = {DecisionKind.YIELD: "yielding", DecisionKind.OVERTAKE: "going first"}


def price(words: str) -> float:
    return float("inf") if words == "would collide" else float(words.removeprefix("costs "))


@pytest.mark.parametrize("name", ["everyday/junction", "paper/crossing_pedestrian"])
def test_the_chosen_order_costs_least_and_its_reason_states_the_gap(name: str) -> None:
    drive = run_closed_loop(scenario(name), "dp_qp", keep_internals=True)
    counts = dict.fromkeys(WORDS, 0)
    for frame in drive.trace.frames:
        graphs = [item for item in frame.plan.internals if isinstance(item, StGraph)]
        for item in frame.plan.internals:
            if not isinstance(item, Decision) or (found := SAID.search(item.reason)) is None:
                continue
            keeps, first, cost, second, other = found.groups()
            assert WORDS[item.kind] == first != second
            counts[item.kind] += 1
            if "cannot be there first" not in item.reason:
                assert price(cost) <= price(other) + 0.1, f"{frame.t:.1f} s: {item.reason}"
            outlines = [
                thing.outline
                for graph in graphs
                for thing in graph.obstacles
                if thing.agent == item.agent
            ]
            if keeps is not None and len(outlines) == 1:
                assert clear(graphs[0].qp, outlines[0], item.kind) == pytest.approx(
                    float(keeps), abs=0.06
                )
    assert counts[DecisionKind.YIELD] > 5, counts


def clear(qp: np.ndarray, outline: np.ndarray, kind: DecisionKind) -> float:
    """By how much the solution is behind (or ahead of) the lower (upper) half of an outline, m."""
    low, high = outline[: len(outline) // 2], outline[len(outline) // 2 :]
    side = low if kind is DecisionKind.YIELD else high
    s = np.interp(side[:, 0], *qp.T)
    return float((side[:, 1] - s).min() if kind is DecisionKind.YIELD else (s - side[:, 1]).min())
