"""Path stage: the room and who stands in it, the side that is taken, and the corridor that the path
keeps.
"""

from collections.abc import Sequence

import numpy as np
import pytest
from followed import PERIOD_S
from hypothesis import assume, given, settings, strategies as st
from roads import along_x, curve, lanes
from scenes import CAR, Other, driving, reference, scene, standing

from replan.core.arrays import FloatArray
from replan.logs.frame import PlannerContext
from replan.logs.plan import Decision, DecisionKind, SlGraph
from replan.logs.states import EgoState
from replan.planners.dp_qp.goal_window import GoalWindow
from replan.planners.dp_qp.path.bounds import (
    NOTHING,
    SIDES,
    InTheWay,
    PathBounds,
    free_sides,
    lane_bounds,
    narrow_bounds,
    side_choices,
    standing_obstacles,
)
from replan.planners.dp_qp.path.corridor import LOWER, UPPER, EgoInLane, S, road_ahead
from replan.planners.dp_qp.path.dp import PathDpConfig
from replan.planners.dp_qp.path.stage import ChosenPath, PathConfig, PathMemory, PathStage
from replan.planners.dp_qp.path.steering_reach import expected_speed
from replan.planners.frenet.path import MIN_REGULAR
from replan.planners.frenet.reference_path import ReferencePath
from replan.planners.frenet.scene import Occupancy

OFFSET, SLOPE, BEND = st.floats(-3.0, 3.0), st.floats(-0.5, 0.5), st.floats(-0.1, 0.1)

TURNS = np.array([CAR.max_kappa, CAR.max_steer_rate / CAR.wheelbase])


STRAIGHT, LEFT_TURN = (
    reference(along_x()),
    reference(curve((30.0, 0.0), (60.0, 1.0 / 30.0), (60.0, 0.0))),
)
SIDE = 0.5 * CAR.width
LEADS = (0.0, CAR.axle_to_front)
CONFIG = PathConfig()
GAPS = CONFIG.corridor
EGO = EgoState(0.0, 0.0, 0.0, 0.0, 8.0)


@given(
    st.floats(20.0, 70.0),
    st.floats(-2.5, 2.5),
    st.floats(-3.0, 3.0),
    st.floats(1.0, 25.0),
    st.floats(0.5, 2.5),
)
@settings(max_examples=40)
def test_the_box_of_an_obstacle_holds_its_outline(
    s: float, l: float, yaw: float, length: float, width: float
) -> None:
    line = LEFT_TURN.line
    x, y = line.point(s, l)
    other = standing("it", x, y, yaw, length=length, width=width)
    found = standing_obstacles(scene(LEFT_TURN, EGO, [other]), 130.0)
    assume(found)
    u = np.linspace(-0.5, 0.5, 41)
    along, across = np.meshgrid(length * u, width * u)
    inner = (
        x + along * np.cos(yaw) - across * np.sin(yaw),
        y + along * np.sin(yaw) + across * np.cos(yaw),
    )
    feet = np.array(
        [line.project(a, b, s, 40.0) for a, b in zip(*(v.ravel() for v in inner), strict=True)]
    )
    # (length / 2)^2 / 8 R: sides are tested at their middles
    box, slack = found[0], 0.02 + length**2 / 960.0
    assert box.s_from <= feet[:, 0].min() + slack and box.s_to >= feet[:, 0].max() - slack
    assert box.l_from <= feet[:, 1].min() + slack and box.l_to >= feet[:, 1].max() - slack


def test_only_agents_that_stand_on_the_road_ahead_are_obstacles() -> None:
    others = [
        standing("ahead", 40.0, 0.0),
        standing("kerb", 40.0, -3.0),
        standing("field", 40.0, -6.0),
        standing("behind", -20.0, 0.0),
        standing("far", 300.0, 0.0),
        driving("moving", 30.0, 0.0, 3.0),
    ]
    found = standing_obstacles(scene(STRAIGHT, EGO, others), 130.0)
    assert [box.agent for box in found] == ["ahead", "kerb"]


def room(
    lower: float = -1.0, upper: float = 1.0, step: float = 1.0, length: float = 100.0
) -> PathBounds:
    s = np.arange(0.0, length, step) + np.array(LEADS)[:, None]
    return PathBounds(s, np.full(s.shape, lower), np.full(s.shape, upper))


def test_the_room_ends_short_of_the_centre_of_a_turn() -> None:
    tight = reference(np.array(curve((30.0, 0.0), (20.0, 0.25), (30.0, 0.0), step=0.5)), 2)
    s = np.arange(0.0, 80.0, 1.0)
    everywhere = InTheWay((Occupancy("it", 0.0, 80.0, -5.0, -4.0),))
    free = lane_bounds(tight, s, everywhere, 4.0, CAR, GAPS)
    kappa = np.interp(s, tight.line.s, tight.line.kappa)
    assert (1.0 - kappa * free.upper).min() >= MIN_REGULAR - 1e-9 and (
        free.lower < free.upper
    ).all()
    assert free.upper.max() > 4.0 > 3.7 > free.upper[np.argmax(kappa)]


GOES_LEFT, GOES_RIGHT = 5.0, -5.0


@given(
    st.floats(-4.0, 4.0),
    st.floats(0.3, 2.0),
    st.sampled_from([GOES_LEFT, GOES_RIGHT]),
    st.floats(0.5, 4.0),
)
def test_a_side_is_taken_only_where_there_is_room(
    middle: float, width: float, aim: float, step: float
) -> None:
    """And the corridor that it leaves keeps the clearance along the whole obstacle, whatever the
    knots' spacing.
    """
    box = Occupancy("it", 40.0, 44.5, middle - 0.5 * width, middle + 0.5 * width)
    space = room(-2.0, 3.0, step)
    decision = side_choices((box,), space, CAR, GAPS)[0].decided(aim == GOES_LEFT, None, GAPS)
    narrow, (final,) = narrow_bounds(space, (box,), (decision,), CAR, GAPS)
    lower, upper = narrow.lower, narrow.upper
    left, right = 3.0 - box.l_to - SIDE, box.l_from - SIDE + 2.0
    before, after = (
        0.5 * CAR.axle_to_front + step,
        max(0.5 * CAR.axle_to_front, CAR.rear_overhang) + step,
    )
    beside = (space.s > 40.0 - before) & (space.s < 44.5 + after)
    assert (lower <= upper).all()
    if final.kind is DecisionKind.NUDGE_LEFT:
        assert (lower[beside] >= box.l_to + SIDE + min(GAPS.clearance_m, left - 0.02) - 1e-9).all()
        assert left >= GAPS.min_clearance_m and (aim == GOES_LEFT or right < GAPS.min_clearance_m)
    elif final.kind is DecisionKind.NUDGE_RIGHT:
        assert (
            upper[beside] <= box.l_from - SIDE - min(GAPS.clearance_m, right - 0.02) + 1e-9
        ).all()
        assert right >= GAPS.min_clearance_m and (aim == GOES_RIGHT or left < GAPS.min_clearance_m)
    elif final.kind is DecisionKind.STOP:
        assert max(left, right) < GAPS.min_clearance_m and "no room" in final.reason
    else:
        assert final.kind is DecisionKind.IGNORE
        assert (
            box.l_to + SIDE + GAPS.clearance_m <= -2.0
            or box.l_from - SIDE - GAPS.clearance_m >= 3.0
        )


def test_two_obstacles_that_close_the_corridor_are_a_stop() -> None:
    boxes = Occupancy("right", 40.0, 44.0, -2.0, -0.2), Occupancy("left", 40.0, 44.0, 0.2, 2.0)
    decisions = (
        Decision("right", DecisionKind.NUDGE_LEFT, "path", ""),
        Decision("left", DecisionKind.NUDGE_RIGHT, "path", ""),
    )
    narrow, final = narrow_bounds(room(), boxes, decisions, CAR, GAPS)
    assert DecisionKind.STOP in {decision.kind for decision in final}
    assert (narrow.lower <= narrow.upper).all()


@given(OFFSET, SLOPE, BEND, st.floats(0.0, 20.0))
def test_the_room_is_widened_for_an_ego_outside_of_it(
    l0: float, dl0: float, ddl0: float, speed: float
) -> None:
    def points(*start: float) -> FloatArray:
        ego = EgoInLane(
            np.array([0.0, *start, speed]), np.array(LEADS), np.array([*TURNS, 3.0]), SIDE
        )
        line, none = STRAIGHT.line, np.empty((0, 2))
        return road_ahead(
            line.s, STRAIGHT.table, ego, 1.0, 100, 0.0, NOTHING, np.empty((3, 0)), none
        ).points

    space, wide = points(0.0, 0.0, 0.0), points(l0, dl0, ddl0)
    assert wide[LOWER, 0, 0] <= l0 <= wide[UPPER, 0, 0]
    assert (wide[LOWER] <= space[LOWER]).all() and (wide[UPPER] >= space[UPPER]).all()
    far = space[S] > max(12.0, 2.5 * speed) + 1.0
    np.testing.assert_array_equal(wide[LOWER, far], space[LOWER, far])


def test_no_agent_may_move_on_a_lane_that_is_borrowed() -> None:
    two = reference(along_x(), 2)

    def free(*others: Other) -> tuple[bool, bool]:
        return free_sides(scene(two, EGO, others), GAPS)

    assert free() == (True, True)
    assert free(driving("beside", -20.0, 3.5, 9.0)) == (False, True)
    assert free(driving("own lane", 30.0, 0.0, 5.0)) == (True, True)
    assert free(driving("far behind", -60.0, 3.5, 9.0)) == (True, True)
    assert free(standing("parked", 20.0, 3.5)) == (True, True)


def test_a_lane_is_borrowed_only_beside_an_obstacle() -> None:
    s = np.arange(0.0, 200.0, 1.0)
    two, box = reference(along_x(), 2), Occupancy("it", 100.0, 104.5, -2.0, 0.0)
    kept, passed = (
        lane_bounds(two, s, way, 4.0, CAR, GAPS) for way in (InTheWay(), InTheWay((box,)))
    )
    np.testing.assert_array_equal(passed.lower, kept.lower)
    used = s[passed.upper > kept.upper]
    assert used.min() == pytest.approx(100.0 - CAR.axle_to_front - 15.0, abs=1.0)
    assert used.max() == pytest.approx(104.5 + CAR.rear_overhang + 15.0, abs=1.0)


# The stage as a whole.


def stage(along: ReferencePath, config: PathConfig = CONFIG) -> PathStage:
    context = PlannerContext(
        lanes(along_x()), None, CAR, PERIOD_S, EgoState(0.0, 0.0, 0.0, 0.0, 0.0)
    )
    return PathStage(
        context, config, GoalWindow(None, along, CAR), horizon=8.0, curve_accel_mps2=3.0
    )


def chosen(along: ReferencePath, ego: EgoState, others: Sequence[Other] = ()) -> ChosenPath:
    """The path of a stage that remembers nothing."""
    return stage(along).choose(scene(along, ego, others), PathMemory())[0]


def graph_of(found: ChosenPath) -> SlGraph:
    return next(item for item in found.artefacts() if isinstance(item, SlGraph))


def outside(along: ReferencePath, found: ChosenPath) -> FloatArray:
    """By how much each corner of the ego is outside the reported corridor along the path
    `(points, 4)`, m.

    Beyond its end, which a corner in front of the rear axle passes before the path ends, there is
    no corridor: -inf.
    """
    path, corridor_ = found.path, graph_of(found).corridor
    assert path is not None and corridor_ is not None
    lost = []
    for x, y, yaw, s in zip(path.x, path.y, path.yaw, path.s, strict=True):
        for ahead in (CAR.axle_to_front, -CAR.rear_overhang):
            for side in (SIDE, -SIDE):
                at = (
                    x + ahead * np.cos(yaw) - side * np.sin(yaw),
                    y + ahead * np.sin(yaw) + side * np.cos(yaw),
                )
                there, l = along.line.project(*at, s + ahead, 8.0)
                low, high = (
                    np.interp(there, corridor_.first, v) for v in (corridor_.lower, corridor_.upper)
                )
                lost.append(
                    max(low - SIDE - l, l - high - SIDE)
                    if there <= corridor_.first[-1]
                    else -np.inf
                )
    return np.reshape(lost, (-1, 4))


ROADS = st.lists(st.tuples(st.floats(15.0, 50.0), st.floats(-0.1, 0.1)), min_size=1, max_size=4)
PARKED = st.lists(
    st.tuples(st.floats(15.0, 90.0), st.floats(-3.0, 3.0), st.floats(-0.4, 0.4)), max_size=3
)


def world(
    bends: list[tuple[float, float]], parked: list[tuple[float, float, float]]
) -> tuple[ReferencePath, list[Other]]:
    """Two lanes along a winding road, the first the reference's, and others standing at (s, l,
    yaw).
    """
    ends = np.cumsum([0.0, 30.0] + [length for length, _ in bends])
    kappa = np.interp(np.arange(0.0, ends[-1] + 150.0), ends, [0.0, 0.0] + [k for _, k in bends])
    along = reference(curve(*[(1.0, float(k)) for k in kappa]), 2)
    others = []
    for i, (s, l, turn) in enumerate(parked):
        x, y, yaw, _ = (*along.line.point(s, l), *along.line.frame(s)[2:])
        others.append(standing(f"parked {i}", x, y, yaw + turn))
    return along, others


@given(ROADS, PARKED, st.floats(0.5, 14.0), st.floats(-0.4, 0.4))
@settings(max_examples=60, deadline=None)
def test_the_corners_of_the_ego_stay_in_the_corridor(
    bends: list[tuple[float, float]],
    parked: list[tuple[float, float, float]],
    v: float,
    aside: float,
) -> None:
    """All along the path, up to what lies between two knots."""
    along, others = world(bends, parked)
    x, y, yaw, kappa = (*along.line.point(5.0, aside), *along.line.frame(5.0)[2:])
    found = chosen(along, EgoState(0.0, x, y, yaw, v, 0.0, kappa), others)
    assert found.path is not None and not found.reason
    if any(report.stage != "path QP" for report in found.reports):
        return  # the corridor could not be kept
    assert outside(along, found).max() <= 0.2


THREE = lanes(along_x(), 3)
MIDDLE = reference(THREE, ego=EgoState(0.0, 30.0, 3.5, 0.0, 8.0))


def side_taken(
    l: float,
    memory: PathMemory,
    v: float,
    config: PathDpConfig = CONFIG.dp,
) -> tuple[DecisionKind, PathMemory]:
    """The decision about a narrow obstacle `l` m left of the middle of three lanes, and what is
    remembered of it.
    """
    now = scene(
        MIDDLE, EgoState(0.0, 30.0, 3.5, 0.0, v), [standing("it", 60.0, 3.5 + l, width=0.8)]
    )
    found, after = stage(MIDDLE, PathConfig(config)).choose(now, memory)
    (decision,) = (item for item in found.artefacts() if isinstance(item, Decision))
    return decision.kind, after


@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(3.0, 9.0))
@settings(max_examples=25, deadline=None)
def test_the_side_does_not_change_while_nothing_changes(l: float, then: float, v: float) -> None:
    """It may be seen a little further to one side in the next frame."""
    first, memory = side_taken(l, PathMemory(), v)
    assert first in SIDES
    assert side_taken(then, memory, v)[0] is first


def test_without_memory_the_side_does_change() -> None:
    """That is: the law above can fail."""
    forgetful = PathDpConfig(w_switch=0.0)
    first, memory = side_taken(-0.15, PathMemory(), 8.0, forgetful)
    assert side_taken(0.15, memory, 8.0, forgetful)[0] is not first
    assert side_taken(0.15, PathMemory(), 8.0)[0] is not first


def test_a_good_reason_changes_the_side() -> None:
    first, memory = side_taken(-0.1, PathMemory(), 8.0)
    assert first is DecisionKind.NUDGE_LEFT
    assert side_taken(1.2, memory, 8.0)[0] is DecisionKind.NUDGE_RIGHT


@given(st.floats(12.0, 70.0), st.floats(-1.5, 1.5), st.floats(2.0, 16.0))
@settings(max_examples=30, deadline=None)
def test_a_swerve_needs_no_more_than_comfortable_lateral_acceleration(
    ahead: float, l: float, v: float
) -> None:
    """Nor more than the lock, nor a faster turn of the wheels, at the speed that may be
    expected.
    """
    ego = EgoState(0.0, 30.0, 3.5, 0.0, v)
    found = chosen(MIDDLE, ego, [standing("it", 30.0 + ahead, 3.5 + l)])
    assert found.path is not None
    assume(all(item.stage == "path QP" for item in found.reports))
    way, none = found.path, np.zeros(len(found.path.sigma))
    fast = expected_speed(v, none + 13.89, none, float(way.s[1] - way.s[0]), 1.8, 3.0, 3.0)
    # Bounds hold at knots, up to 2 m apart
    slow = np.maximum(np.interp(way.s - 2.0, way.s, fast), 1.0)
    assert (
        np.abs(way.kappa)
        <= np.minimum(4.0 / np.minimum(slow, fast) ** 2, CAR.max_kappa) * 1.1 + 2e-3
    ).all()
    turned = np.abs(np.diff(way.kappa) / np.diff(way.sigma))
    assert (turned <= 1.2 * TURNS[1] / np.maximum(np.minimum(slow, fast)[1:], 1.0) + 2e-3).all()


def test_an_obstacle_too_near_to_swerve_is_a_stop() -> None:
    """At 14 m/s, 8 m before the bumper: the path cannot clear it, says so, and the speed stage
    meets it.
    """
    found = chosen(MIDDLE, EgoState(0.0, 30.0, 3.5, 0.0, 14.0), [standing("it", 44.0, 3.5)])
    decisions = [item for item in found.artefacts() if isinstance(item, Decision)]
    assert [item.kind for item in decisions] == [
        DecisionKind.STOP
    ] and "steering cannot" in decisions[0].reason
    assert found.path is not None and not found.passed


def test_a_path_ends_where_the_lane_turns_beyond_the_lock() -> None:
    """A hairpin of 2.6 m in a lane of 3 m: driven to its beginning."""
    hairpin = reference(curve((60.0, 0.0), (8.0, 1.0 / 2.6), (60.0, 0.0), step=0.5))
    found = chosen(hairpin, EgoState(0.0, 0.0, 0.0, 0.0, 5.0))
    assert found.path is not None
    beyond = found.path.sigma > 5.0
    assert np.abs(found.path.kappa[beyond]).max() <= 1.06 * CAR.max_kappa
