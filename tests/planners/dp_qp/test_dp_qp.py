"""The whole planner: laws of mirrored, moved and truncated worlds.

What it does about others, and in trouble.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from followed import PERIOD_S, decided, followed, gaps, planner
from hypothesis import given, settings, strategies as st
from roads import along_x, lanes
from scenes import CAR, Other, driving, frame, standing

from replan.logs.agents import AgentKind
from replan.logs.catalogue import CATALOGUE
from replan.logs.edit.transform import mirrored, moved
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.plan import (
    CostTerms,
    Decision,
    DecisionKind,
    Plan,
    PlanStart,
    PlanStatus,
    SlGraph,
    SolverReport,
    StGraph,
)
from replan.logs.road import Road
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS, EgoState, wrapped
from replan.planners.base import Planner
from replan.planners.dp_qp import DpQp, DpQpConfig
from replan.planners.dp_qp.lane import LaneConfig, LaneMemory, LanePlanner
from replan.planners.dp_qp.path.qp import PathQp
from replan.planners.dp_qp.speed.qp import SpeedQp, SpeedQpConfig
from replan.planners.dp_qp.speed.stage import DOUBTED
from replan.planners.frenet.lane_sequences import LaneSequences
from replan.planners.frenet.profiles import meets
from replan.planners.solver import QPResult
from replan.replay.prediction import predict

ONE, TWO = lanes(along_x()), lanes(along_x(), 2)
EGO = EgoState(0.0, 0.0, 0.0, 0.0, 8.0)
COMFORT = SpeedQpConfig().comfort
NUDGES = (DecisionKind.NUDGE_LEFT, DecisionKind.NUDGE_RIGHT)


def column(plan: Plan, name: str) -> np.ndarray:
    return getattr(plan.trajectory, name)


def assert_same(one: Plan, two: Plan) -> None:
    for name in TRAJECTORY_COLUMNS:
        np.testing.assert_array_equal(column(one, name), column(two, name))
    assert (one.status, one.reason, one.start) == (two.status, two.reason, two.start)


def assert_sound(plan: Plan) -> None:
    """A trajectory that a car can be asked to drive: forward, along its heading, with the
    acceleration that it says.
    """
    assert not plan.status.is_fallback or plan.reason
    t, x, y, yaw, v, a, kappa = (column(plan, name) for name in TRAJECTORY_COLUMNS)
    assert (v >= 0.0).all() and np.isfinite(kappa).all()
    step, dt = np.hypot(np.diff(x), np.diff(y)), np.diff(t)
    np.testing.assert_allclose(step, 0.5 * dt * (v[1:] + v[:-1]), atol=0.05)
    np.testing.assert_allclose(np.diff(v), 0.5 * dt * (a[1:] + a[:-1]), atol=0.05)
    go = step > 0.05
    reference = np.arctan2(np.diff(y), np.diff(x)) - 0.5 * (yaw[1:] + yaw[:-1])
    assert np.abs(wrapped(reference[go])).max(initial=0.0) < 0.1


def plans_in(scenario: Scenario, *, every: int, closed: bool) -> list[Plan]:
    """Plans from the logged states, or of a closed loop without tracking errors, each `every`
    frames.
    """
    context = PlannerContext(
        scenario.road, scenario.goal, scenario.vehicle, PERIOD_S, scenario.ego.state(0)
    )
    driver, previous, ego, found = DpQp(context), None, scenario.ego.state(0), []
    for k in range(int(scenario.ego.t[-1] / PERIOD_S)):
        t = round(k * PERIOD_S, 9)
        if not closed and k % every:
            continue
        known = scenario.tracks.perceived(t)
        now = Frame(
            t,
            ego if closed else scenario.ego.at(t),
            known,
            predict(known, t),
            previous if closed else None,
        )
        previous = driver.plan(now)
        ego = previous.trajectory.at(t + PERIOD_S)
        if k % every == 0:
            found.append(previous)
    return found


@pytest.fixture(scope="module")
def catalogue() -> dict[str, tuple[Scenario, list[Plan]]]:
    scenarios = {name: family.scenario() for name, family in CATALOGUE.items()}
    return {name: (log, plans_in(log, every=15, closed=False)) for name, log in scenarios.items()}


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_mirrored_world_has_the_mirrored_plan(
    name: str, catalogue: dict[str, tuple[Scenario, list[Plan]]]
) -> None:
    """Bit by bit: sums and products do not know a sign, and ties go to the passing side.

    Where the road turns by 90 degrees, the sine of an angle and of its mirror image round
    differently.
    """
    log, plans = catalogue[name]
    atol = 1e-6 if name == "everyday/bend" else 0.0
    for one, two in zip(plans, plans_in(mirrored(log), every=15, closed=False), strict=True):
        for same in ("t", "x", "v", "a"):
            np.testing.assert_allclose(column(two, same), column(one, same), rtol=0.0, atol=atol)
        for flipped in ("y", "yaw", "kappa"):
            np.testing.assert_allclose(
                column(two, flipped), -column(one, flipped), rtol=0.0, atol=max(atol, 1e-12)
            )
        assert (one.status, one.reason, one.start) == (two.status, two.reason, two.start)


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_moved_world_has_the_moved_plan(
    name: str, catalogue: dict[str, tuple[Scenario, list[Plan]]]
) -> None:
    """To 1e-6."""
    log, plans = catalogue[name]
    c, s = np.cos(0.7), np.sin(0.7)
    for one, two in zip(
        plans, plans_in(moved(log, 100.0, -70.0, 0.7), every=15, closed=False), strict=True
    ):
        x, y = column(one, "x"), column(one, "y")
        np.testing.assert_allclose(column(two, "x"), 100.0 + c * x - s * y, rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(column(two, "y"), -70.0 + s * x + c * y, rtol=0.0, atol=1e-6)
        for same in ("t", "v", "a", "kappa"):
            np.testing.assert_allclose(column(two, same), column(one, same), rtol=0.0, atol=1e-6)
        assert (one.status, one.start) == (two.status, two.start)


@pytest.mark.parametrize("name", ["paper/crossing_pedestrian", "everyday/cut_in"])
def test_the_future_of_the_log_changes_nothing(name: str) -> None:
    log = CATALOGUE[name].scenario()
    context = PlannerContext(log.road, log.goal, log.vehicle, PERIOD_S, log.ego.state(0))
    for t in (0.0, 4.0, 7.3, 12.0):
        known, less = (
            log.tracks.perceived(t),
            log.tracks.taken(log.tracks.t <= t + 1e-9).perceived(t),
        )
        one, two = (
            DpQp(context).plan(Frame(t, log.ego.at(t), a, predict(a, t))) for a in (known, less)
        )
        assert_same(one, two)


CROWD = (
    standing("parked", 35.0, -1.9),
    driving("lead", 50.0, 0.0, 6.0),
    driving("walker", 30.0, -9.0, 0.0, 1.2, length=0.5, width=0.6, kind=AgentKind.PEDESTRIAN),
    driving("beside", -15.0, 3.5, 9.0),
)


def test_a_planner_without_a_previous_plan_remembers_nothing() -> None:
    """After a drive with other speeds, solver failures and lengths, the plan is that of a new
    planner, bit by bit.
    """
    used = planner(TWO, EGO)
    for now, _ in followed(TWO, replace(EGO, v=12.0), CROWD, seconds=3.0, build=lambda *_: used):
        assert now is not None
    for others in ((), CROWD, (standing("wall", 14.0, 0.0, width=9.0),)):
        now = frame(replace(EGO, x=3.0, y=0.4), others)
        assert_same(used.plan(now), planner(TWO, EGO).plan(now))


@given(
    st.floats(-1.0, 1.0),
    st.floats(-0.2, 0.2),
    st.floats(0.0, 15.0),
    st.floats(-1.5, 1.5),
    st.floats(-0.05, 0.05),
)
@settings(max_examples=25)
def test_a_first_plan_starts_at_the_ego(
    y: float, yaw: float, v: float, a: float, kappa: float
) -> None:
    ego = EgoState(2.0, 5.0, y, yaw, v, a, kappa)
    plan = planner(ONE, ego).plan(frame(ego, t=2.0))
    assert plan.start is PlanStart.EGO and plan.status is PlanStatus.PLANNED
    assert_sound(plan)
    first = plan.trajectory.state(0)
    for name, slack in (
        ("t", 0.0),
        ("x", 1e-6),
        ("y", 1e-3),
        ("yaw", 1e-3),
        ("v", 0.02),
        ("kappa", 2e-3),
    ):
        assert getattr(first, name) == pytest.approx(getattr(ego, name), abs=slack)
    # More the car cannot release before it stands
    startable = -np.sqrt(2.0 * 0.9 * COMFORT.jerk_mps3 * v)
    assert first.a == pytest.approx(max(a, startable), abs=0.02)


@pytest.mark.parametrize(
    ("off", "start"),
    [
        ({}, PlanStart.PREVIOUS_PLAN),
        ({"y": 0.45}, PlanStart.PREVIOUS_PLAN),
        ({"v": 0.9}, PlanStart.PREVIOUS_PLAN),
        ({"y": 0.55}, PlanStart.EGO),
        ({"v": 1.1}, PlanStart.EGO),
    ],
)
def test_a_plan_goes_on_where_the_ego_follows(off: dict[str, float], start: PlanStart) -> None:
    driver = planner(ONE, EGO)
    previous = driver.plan(frame(EGO))
    promised = previous.trajectory.at(0.1)
    ego = replace(
        promised, **{name: getattr(promised, name) + value for name, value in off.items()}
    )
    plan = driver.plan(frame(ego, t=0.1, previous=previous))
    assert plan.start is start
    origin = ego if start is PlanStart.EGO else promised
    assert column(plan, "y")[0] == pytest.approx(origin.y, abs=1e-3)
    assert column(plan, "v")[0] == pytest.approx(origin.v, abs=0.02)


def test_a_plan_has_graphs_decisions_costs_and_reports() -> None:
    """Also the path DP: the box can be passed on either side, so that it had to decide."""
    plan = planner(TWO, EGO).plan(
        frame(EGO, (standing("box", 35.0, 1.75, length=0.5, width=0.5), *CROWD[1:3]))
    )
    sl, st_ = (
        next(item for item in plan.internals if isinstance(item, kind))
        for kind in (SlGraph, StGraph)
    )
    for graph in (sl, st_):
        assert (
            graph.grid is not None
            and graph.corridor is not None
            and len(graph.qp)
            and len(graph.dp)
        )
        assert graph.grid.cost.shape == (len(graph.grid.first), len(graph.grid.second))
        np.testing.assert_array_equal(graph.corridor.first, graph.qp[:, 0])
    np.testing.assert_allclose(st_.qp[:, 0], column(plan, "t"), atol=1e-9)
    assert {item.stage for item in plan.internals if isinstance(item, CostTerms)} == {
        "path QP",
        "speed QP",
    }
    assert all(item.solved for item in plan.internals if isinstance(item, SolverReport))


# What it does about others.


@st.composite
def traffic(draw: st.DrawFn) -> list[Other]:
    """Up to three others: crossing, ahead, standing, cutting in."""
    found = []
    for i in range(draw(st.integers(1, 3))):
        kind, name, x = (
            draw(st.sampled_from(["crosses", "leads", "stands", "cuts in"])),
            f"it{i}",
            draw(st.floats(12.0, 80.0)),
        )
        if kind == "crosses":
            vy, when = (
                draw(st.sampled_from([-1.0, 1.0])) * draw(st.floats(1.0, 9.0)),
                draw(st.floats(0.5, 7.0)),
            )
            found.append(driving(name, x, -vy * when, 0.0, vy))
        elif kind == "leads":
            found.append(driving(name, x, 0.0, draw(st.floats(0.6, 12.0))))
        elif kind == "stands":
            found.append(standing(name, x, draw(st.floats(-2.5, 2.5))))
        else:
            found.append(
                driving(name, 0.5 * x, 3.5, draw(st.floats(3.0, 14.0)), -draw(st.floats(0.3, 1.5)))
            )
    return found


def is_doubted(decision: Decision) -> bool:
    return DOUBTED in decision.reason or "that is unlikely" in decision.reason


@given(st.floats(0.0, 14.0), traffic())
@settings(max_examples=50)
def test_a_plan_touches_no_predicted_agent_unless_its_status_says_so(
    v: float, others: list[Other]
) -> None:
    ego = replace(EGO, v=v)
    now = frame(ego, others)
    plan = planner(TWO, ego).plan(now)
    assert_sound(plan)
    doubted = {
        each.agent for each in plan.internals if isinstance(each, Decision) and is_doubted(each)
    }
    if plan.status is PlanStatus.PLANNED:
        assert not meets(
            plan.trajectory, frame(ego, [other for other in others if other.id not in doubted]), CAR
        )
    elif meets(plan.trajectory, now, CAR):
        assert plan.status is PlanStatus.HARD_STOP


def test_an_agent_that_the_ego_cannot_pass_first_is_let_go() -> None:
    """The DP, which knows no jerk, would be there first; the QP cannot."""
    ego = replace(EGO, v=2.03)
    now = frame(ego, [driving("it", 29.565, 35.408, 0.0, -6.6046)])
    plan = planner(TWO, ego).plan(now)
    assert plan.status is PlanStatus.PLANNED and not meets(plan.trajectory, now, CAR)
    assert decided(plan, "it", "speed") is DecisionKind.YIELD


@pytest.mark.parametrize(
    ("x", "spare", "expected"),
    [
        (45.0, 0.6, DecisionKind.YIELD),
        (45.0, 3.0, DecisionKind.OVERTAKE),
        (12.0, 1.2, DecisionKind.OVERTAKE),  # nothing but full braking would stop before the walker
    ],
)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_ego_goes_first_with_time_to_spare_only(
    x: float, spare: float, expected: DecisionKind, side: float
) -> None:
    """`spare`: when the walker takes the ego's strip, s after the ego has left the place at its
    speed.
    """
    walks, margins = 1.4, 0.5 * CAR.width + 0.6 + 0.3
    ego = replace(EGO, v=13.0)
    leaves = (x + CAR.rear_overhang + 0.3) / ego.v
    walker = driving(
        "it",
        x,
        side * (walks * (leaves + spare) + margins),
        0.0,
        -side * walks,
        length=0.6,
        width=0.6,
    )
    plan = planner(ONE, ego).plan(frame(ego, [replace(walker, kind=AgentKind.PEDESTRIAN)]))
    assert plan.status is PlanStatus.PLANNED and decided(plan, "it", "speed") is expected
    assert expected is DecisionKind.YIELD or column(plan, "a").min() > -0.5


@pytest.mark.parametrize("v", [5.0, 12.0])
def test_the_ego_stops_behind_a_standing_car_and_stays(v: float) -> None:
    drive = followed(ONE, replace(EGO, v=v), [standing("wall", 70.0, 0.0)], seconds=22.0)
    assert all(plan.status is PlanStatus.PLANNED for _, plan in drive)
    assert decided(drive[0][1], "wall", "speed") is DecisionKind.STOP
    gap = gaps(drive, "wall")
    assert 1.5 < gap[-1] < 3.5
    assert gap[-40] - gap[-1] < 0.01 and drive[-1][0].ego.v == 0.0
    assert min(now.ego.a for now, _ in drive) > -COMFORT.decel_mps2 - 0.05


def test_the_ego_follows_at_the_leads_speed() -> None:
    drive = followed(ONE, replace(EGO, v=12.0), [driving("lead", 35.0, 0.0, 7.0)], seconds=20.0)
    gap = gaps(drive, "lead")
    assert drive[-1][0].ego.v == pytest.approx(7.0, abs=0.3)
    assert 5.0 < gap[-1] < 7.0 * 2.5 and gap.min() > 4.0
    assert abs(gap[-30] - gap[-1]) < 1.0
    assert decided(drive[-1][1], "lead", "speed") is DecisionKind.FOLLOW


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_parked_cars_are_passed_on_the_free_side(side: float) -> None:
    """The first reaches in from the right by half a metre, the second from the left (and
    mirrored).
    """
    others = [standing("first", 50.0, -side * 2.15), standing("second", 100.0, side * 2.15)]
    drive = followed(ONE, EGO, others, seconds=16.0)
    expected = NUDGES if side > 0.0 else NUDGES[::-1]
    assert (
        decided(drive[0][1], "first", "path"),
        decided(drive[0][1], "second", "path"),
    ) == expected
    assert drive[-1][0].ego.x > 120.0
    for name, kind in zip(("first", "second"), expected, strict=True):
        assert gaps(drive, name).min() > 0.5
        kinds = {decided(plan, name, "path") for _, plan in drive}
        assert kinds <= {kind, None}


@pytest.mark.parametrize("blocked", [False, True])
def test_a_car_in_the_lane_is_passed_over_the_next_lane_if_that_is_free(blocked: bool) -> None:
    others = [standing("parked", 60.0, -0.6)]
    others += [driving("beside", 4.0, 3.5, 8.0)] if blocked else []
    plan = planner(TWO, EGO).plan(frame(EGO, others))
    assert decided(plan, "parked", "path") is (
        DecisionKind.STOP if blocked else DecisionKind.NUDGE_LEFT
    )
    drive = followed(TWO, EGO, [others[0]], seconds=12.0)
    assert drive[-1][0].ego.x > 80.0 and gaps(drive, "parked").min() > 0.3


def walker(t: float) -> tuple[float, float, float, float, float]:
    """Crosses from the right at 1 m/s, then stands beside the lane."""
    y = min(-5.0 + t, 5.0)
    return 45.0, y, 0.5 * np.pi, 0.0, 1.0 if y < 5.0 else 0.0


def test_the_ego_yields_to_a_pedestrian_and_drives_on() -> None:
    drive = followed(
        ONE, EGO, [Other("walker", walker, AgentKind.PEDESTRIAN, 0.5, 0.6)], seconds=14.0
    )
    speed = np.array([now.ego.v for now, _ in drive])
    assert gaps(drive, "walker").min() > 1.0
    assert decided(drive[10][1], "walker", "speed") is DecisionKind.YIELD
    assert speed.min() < 6.5 and speed[-1] > 10.0 and drive[-1][0].ego.x > 60.0
    assert all(plan.status is PlanStatus.PLANNED for _, plan in drive)


# Odd starts and roads.


ODD: dict[str, tuple[EgoState, Road, Sequence[Other]]] = {
    "60 degrees off, standing": (replace(EGO, yaw=np.radians(-60.0), v=0.0), TWO, ()),
    "standing": (replace(EGO, v=0.0), ONE, ()),
    "braking hard": (replace(EGO, a=-8.0), ONE, ()),
    "accelerating hard": (replace(EGO, v=1.0, a=5.0), ONE, ()),
    "steering hard": (replace(EGO, v=3.0, kappa=0.25), ONE, ()),
    "rolling backwards": (replace(EGO, v=-0.5), ONE, ()),
    "far too fast": (replace(EGO, v=40.0), ONE, ()),
    "beyond the end of the road": (replace(EGO, x=420.0), ONE, ()),
    "before its begin": (replace(EGO, x=-80.0), ONE, ()),
    "an agent on the ego": (EGO, TWO, [standing("it", 1.0, 0.2)]),
    "an agent on the standing ego": (replace(EGO, v=0.0), TWO, [standing("it", 1.0, 0.2)]),
}


@pytest.mark.parametrize("name", ODD)
def test_odd_starts_and_roads_give_a_plan_or_a_reason(name: str) -> None:
    ego, road, others = ODD[name]
    for _, plan in followed(road, ego, others, seconds=3.0):
        assert_sound(plan)
        assert len(plan.trajectory) == 81 or plan.status is PlanStatus.PREVIOUS


def test_against_the_lane_the_ego_stops_and_says_why() -> None:
    ego = replace(EGO, yaw=2.0)
    plan = planner(ONE, ego).plan(frame(ego))
    assert plan.status is PlanStatus.COMFORTABLE_STOP and "115 degrees off" in plan.reason
    assert column(plan, "v")[-1] == 0.0 and column(plan, "yaw")[0] == pytest.approx(2.0)
    assert_sound(plan)


# The ladder of fallbacks.


def failing(program: type[PathQp] | type[SpeedQp], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every solve of a program fail from now on."""
    solve = program.solve

    def fails(self: object, *args: object, **more: object) -> QPResult:
        result = solve(self, *args, **more)  # type: ignore[arg-type]
        return replace(result, report=replace(result.report, solved=False, status="made to fail"))

    monkeypatch.setattr(program, "solve", fails)


def one_plan(others: Sequence[Other] = ()) -> tuple[Planner, Plan]:
    driver = planner(TWO, EGO)
    return driver, driver.plan(frame(EGO, others))


STAGES = pytest.mark.parametrize(("program", "stage"), [(PathQp, "path QP"), (SpeedQp, "speed QP")])


@STAGES
def test_the_first_fallback_is_the_rest_of_the_previous_plan(
    program: type, stage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver, previous = one_plan()
    failing(program, monkeypatch)
    plan = driver.plan(frame(previous.trajectory.at(0.3), t=0.3, previous=previous))
    assert plan.status is PlanStatus.PREVIOUS and plan.start is PlanStart.PREVIOUS_PLAN
    assert plan.reason.startswith(stage)
    np.testing.assert_allclose(column(plan, "x"), column(previous, "x")[3:], atol=1e-9)
    reports = [
        item for item in plan.internals if isinstance(item, SolverReport) and item.stage == stage
    ]
    assert reports and not any(report.solved for report in reports)


@STAGES
def test_the_second_fallback_is_a_comfortable_stop(
    program: type, stage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing(program, monkeypatch)
    _, plan = one_plan()
    assert plan.status is PlanStatus.COMFORTABLE_STOP and plan.start is PlanStart.EGO
    assert plan.reason.startswith(stage)
    assert column(plan, "v")[-1] == 0.0 and column(plan, "a").min() == pytest.approx(
        -COMFORT.decel_mps2
    )
    assert_sound(plan)


@STAGES
def test_the_last_fallback_is_a_hard_stop(
    program: type, stage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing(program, monkeypatch)
    _, plan = one_plan([standing("it", 16.0, 0.0, width=15.0)])
    assert plan.status is PlanStatus.HARD_STOP and plan.reason.startswith(stage)
    assert column(plan, "a").min() < -COMFORT.decel_mps2 - 1.0 and column(plan, "v")[-1] == 0.0


def test_a_previous_plan_that_meets_an_agent_is_not_driven_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    driver, previous = one_plan()
    failing(PathQp, monkeypatch)
    ego = previous.trajectory.at(0.1)
    plan = driver.plan(frame(ego, [standing("it", 40.0, 0.0)], t=0.1, previous=previous))
    assert plan.status is PlanStatus.COMFORTABLE_STOP and plan.start is PlanStart.PREVIOUS_PLAN


def test_the_rest_of_a_previous_plan_is_driven_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """While the solver fails, plan after plan is the rest of the last good one, and then a stop."""
    driver, previous = one_plan()
    failing(PathQp, monkeypatch)
    ego, statuses = previous.trajectory.at(0.1), []
    for k in range(1, 80):
        previous = driver.plan(frame(ego, t=k * PERIOD_S, previous=previous))
        statuses.append(previous.status)
        ego = previous.trajectory.at((k + 1) * PERIOD_S)
        assert_sound(previous)
    first_stop = statuses.index(PlanStatus.COMFORTABLE_STOP)
    assert 48 <= first_stop <= 51 and set(statuses[:first_stop]) == {PlanStatus.PREVIOUS}
    assert ego.v < EGO.v


def test_an_unavoidable_contact_is_braked_for_and_reported() -> None:
    _, plan = one_plan([standing("it", 9.0, 0.0, width=9.0)])
    assert plan.status is PlanStatus.HARD_STOP and "full braking comes" in plan.reason
    assert column(plan, "a").min() == pytest.approx(-CAR.max_decel, abs=0.2)


def perhaps(ahead: float, share: float) -> Frame:
    """A pedestrian who stands beside the lane, `ahead` m away, and walks onto the path with a
    probability.
    """
    t = np.linspace(0.0, 8.0, 81)
    here = frame(
        EGO,
        [
            Other(
                "walker",
                lambda t: (ahead, -3.0, 0.5 * np.pi, 0.0, 0.0),
                AgentKind.PEDESTRIAN,
                0.5,
                0.6,
            )
        ],
    )
    y = np.vstack([np.full(81, -3.0), np.minimum(-3.0 + 1.4 * t, 0.0)])
    x, yaw, who = np.full((2, 81), ahead), np.full((2, 81), 0.5 * np.pi), np.zeros(2, np.int64)
    guesses = Predictions(t, who, np.array([1.0 - share, share]), x, y, yaw, "by hand")
    return replace(here, predictions=guesses)


@pytest.mark.parametrize(
    ("ahead", "share", "brakes"), [(40.0, 0.15, False), (40.0, 0.5, True), (16.0, 0.15, True)]
)
def test_an_unlikely_hypothesis_binds_only_where_moderate_braking_would_come_too_late(
    ahead: float, share: float, *, brakes: bool
) -> None:
    plan = planner(ONE, EGO).plan(perhaps(ahead, share))
    made = [each for each in plan.internals if isinstance(each, Decision) and each.stage == "speed"]
    ignored = [each.reason for each in made if each.kind is DecisionKind.IGNORE]
    assert bool(column(plan, "a").min() < -0.5) is brakes
    assert bool(ignored) is not brakes
    assert all("unlikely (37%)" in reason for reason in ignored)


@pytest.mark.parametrize(
    "config", [LaneConfig(), LaneConfig(route_s=2.0, urgency_s=3.0, change_s=4.0)]
)
def test_the_least_costs_of_a_lane_follow_the_settings(config: LaneConfig) -> None:
    """A change that is not due for long costs `route_s`, one that is due now `urgency_s` more."""
    context = PlannerContext(ONE, None, CAR, PERIOD_S, EGO)
    strip = LaneSequences(context).start(EGO)
    for due, urgent in ((1e6, 0.0), (0.0, 1.0)):
        driver = LanePlanner(
            replace(strip, changes=1, change_by=due), context, DpQpConfig(lane=config)
        )
        least = dict(driver.least_costs("left", driver.scene(frame(EGO), EGO, LaneMemory())).terms)
        assert least == {
            "lane changes": config.route_s + urgent * config.urgency_s,
            "change": config.change_s,
            "late": 0.0,
        }


def test_a_lane_that_was_not_planned_for_long_is_found_again() -> None:
    """The foot point is looked for near the last one, but not where the ego has driven on since."""
    context = PlannerContext(ONE, None, CAR, PERIOD_S, EGO)
    driver = LanePlanner(LaneSequences(context).start(EGO), context)
    first = driver.scene(frame(EGO), EGO, LaneMemory())
    _, memory = driver.plan("keep", first, LaneMemory())
    far = replace(EGO, x=120.0, y=0.5)
    later = driver.scene(frame(far), far, memory)
    assert (later.s, later.l) == pytest.approx((first.s + 120.0, 0.5), abs=1e-6)
