"""Why a plan slows down: no sentence contradicts the numbers beside it, for whatever planner.

And a few by hand.
"""

import re
from dataclasses import fields, replace
from itertools import product
from math import inf, isfinite, nan

import numpy as np
import pytest
from handmade import drive, lanes_along, scenario, square, straight, track, tracks
from hypothesis import given, settings, strategies as st

from replan.core.arrays import FloatArray
from replan.explain import Account, Cause, CauseKind, PlanAction, accounts, sentences
from replan.explain.causes import CURVE_MPS2, STAYS_BEHIND, Explainer
from replan.explain.course import (
    GAP_M,
    HEADWAY_S,
    LOOK_S,
    VULNERABLE_MARGIN_M,
    Course,
    Held,
    PlanWay,
    Ways,
    fine,
)
from replan.explain.explanation import NOISE, SHOWS, main_terms
from replan.explain.planner_input import PlannerInput, planner_inputs
from replan.explain.sentences import MOST, conflicts
from replan.logs.catalogue import CATALOGUE
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Decision, DecisionKind, Plan
from replan.logs.road import Goal
from replan.logs.rules import Colour, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance
from replan.logs.states import Trajectory
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop_config import LoopConfig, PlannerProcessConfig
from replan.replay.parts import PLANNER

TRUSTED = LoopConfig(apart=PlannerProcessConfig(trust=True))
LOOPS = {"open": run_open_loop, "closed": run_closed_loop}


class SlowDown:
    """The README's: brakes gently, straight on; looks at no agent."""

    def __init__(self, context: PlannerContext) -> None:
        pass

    def plan(self, frame: Frame) -> Plan:
        ego, t = frame.ego, np.linspace(0.0, 8.0, 81)
        v = np.maximum(ego.v - t, 0.0)
        s = np.r_[0.0, np.cumsum(0.05 * (v[1:] + v[:-1]))]
        x, y = ego.x + s * np.cos(ego.yaw), ego.y + s * np.sin(ego.yaw)
        return Plan(
            Trajectory(
                frame.t + t,
                x,
                y,
                np.full(81, ego.yaw),
                v,
                np.where(v > 0.0, -1.0, 0.0),
                np.zeros(81),
            )
        )


# --------------------------------------------------------------------------------------------------
# the law


def boxes(case: PlannerInput) -> tuple[FloatArray, FloatArray]:
    """Rows x, y, yaw of the predictions `(3, n, k)` every 0.1 s, and length, width of each."""
    assert case.predictions is not None
    _, poses = fine(case.predictions)
    who = case.predictions.agent
    return poses, np.stack([case.agents.length[who], case.agents.width[who]])


def gaps(case: PlannerInput, held: FloatArray, way: PlanWay, world: Scenario) -> FloatArray:
    """Between the ego's box at arc lengths `(k,)` and each prediction `(n, k)`, m; NaN where its
    centre is behind.

    Who touches the ego from behind is behind from then on: a predicted follower drives through a
    held ego.
    """
    poses, sizes = boxes(case)
    car = world.vehicle
    out = np.full(poses.shape[1:], np.nan)
    through = np.zeros(len(out), bool)
    for k, s in enumerate(held):
        x, y, yaw = way.pose(float(s))
        ex, ey = x + car.axle_to_center * np.cos(yaw), y + car.axle_to_center * np.sin(yaw)
        for i in range(len(out)):
            px, py, pyaw = poses[:, i, k]
            gap = distance(
                ex, ey, yaw, car.length, car.width, px, py, pyaw, sizes[0, i], sizes[1, i]
            )
            behind = (px - ex) * np.cos(yaw) + (py - ey) * np.sin(yaw) < 0.0
            through[i] |= behind and gap <= 0.0
            if not behind and not through[i]:
                out[i, k] = gap
    return out


def check(case: PlannerInput, account: Account, world: Scenario, ways: Ways) -> None:
    """The law for one frame."""
    plan, course, said = case.planned.plan, account.course, sentences(account)
    accel = (
        float(np.interp(plan.trajectory.t[0] + 1.0, plan.trajectory.t, plan.trajectory.v))
        - plan.trajectory.v[0]
    )
    assert (course.action is PlanAction.SLOWS) == (
        accel < -0.3 and max(plan.trajectory.v[0], accel) >= 0.1
    )
    causes = [cause for cause in account.causes if cause.kind is not CauseKind.FALLBACK]
    assert plan.status.is_fallback == (len(causes) < len(account.causes))
    if not course.is_asked:
        assert not said or plan.status.is_fallback
        return
    assert said
    if causes:
        opening = said[
            -1
            if plan.status.is_fallback and len(causes) == 0
            else len(account.causes) - len(causes)
        ]
        check_opening(opening, plan, account)
    held, way = Held.of(plan, course), ways.of(plan, Held.of(plan, course).reach)
    known = {(d.agent, d.kind.value, d.reason) for d in plan.internals if isinstance(d, Decision)}
    for cause in causes:
        if cause.decision:
            assert (cause.who, cause.decision, cause.reason) in known
        assert cause.inferred != (cause.decision in {kind.value for kind in STAYS_BEHIND})
        if cause.kind in (CauseKind.AGENT, CauseKind.NONE) and cause.who:
            assert cause.who in case.agents.ids
    if case.predictions is not None and len(case.predictions):
        away = gaps(case, held.s, way, world)
        check_others(case, causes, held, away)
    worded = conflicts(account)
    assert all(
        cause in worded or any(cause.who in one.reason for one in worded) for cause in causes
    )
    for sentence, cause in zip(
        said[len(account.causes) - len(causes) :], worded[:MOST], strict=False
    ):
        check_numbers(sentence, cause, account)


def check_opening(sentence: str, plan: Plan, account: Account) -> None:
    path = plan.trajectory
    if account.course.action is PlanAction.STANDS:
        assert sentence.startswith("Stands")
        assert path.v[path.t <= path.t[0] + 1.0].max() < 0.1 + 1e-9
        return
    if account.course.action is PlanAction.CRAWLS:
        assert sentence.startswith("Crawls")
        assert (
            path.v.min() >= 0.0
            and path.v.max() < 2.0
            and path.a[path.v > 0.1].min(initial=0.0) > -0.31
        )
        return
    later = re.match(r"Slows down from t = ([\d.]+) s on", sentence)
    assert sentence.startswith("Slows down")
    at_first = sentence.startswith("Slows down at first")
    assert (later is None and not at_first) == (account.course.action is PlanAction.SLOWS)
    if at_first:
        assert path.a[path.t <= path.t[0] + 0.1].min() <= -0.3
    if later:
        assert float(later[1]) > path.t[0] + 0.01
        begins = np.abs(path.t - float(later[1])) <= 0.051 + float(np.diff(path.t).max())
        assert path.a[begins].min() <= -0.3


def check_others(case: PlannerInput, causes: list[Cause], held: Held, away: FloatArray) -> None:
    """Who is said to be met is met then and not before; who is not said to be is not."""
    assert case.predictions is not None
    ids = [case.agents.ids[i] for i in case.predictions.agent]
    met = {cause.who for cause in causes if cause.is_met}
    for cause in causes:
        rows = [i for i, name in enumerate(ids) if name == cause.who]
        if cause.kind is CauseKind.AGENT:
            k = round(cause.time_s / 0.1)
            assert cause.time_s == pytest.approx(held.t[k]) and cause.distance_m == pytest.approx(
                held.s[k]
            )
            now = away[rows, 0]
            assert np.isnan(now).all() or np.nanmin(now, initial=1e9) == pytest.approx(
                cause.away_m, abs=0.05
            )
            reach = GAP_M if cause.is_met else HEADWAY_S * held.v
            assert np.nanmin(away[rows, k]) <= np.hypot(reach, VULNERABLE_MARGIN_M) + 0.5
    touched = {ids[i] for i in np.flatnonzero((np.nan_to_num(away, nan=1e9) <= 0.0).any(axis=1))}
    assert touched <= met, "no agent is met without being said"
    unexplained = [cause for cause in causes if cause.kind is CauseKind.NONE]
    # Others are found, too weak for the braking
    weak = [cause for cause in unexplained if isfinite(cause.value)]
    assert not (touched and unexplained and not weak)
    assert not any(
        other.accounts_for(-cause.value) for cause in weak for other in causes if other is not cause
    )


def check_numbers(sentence: str, cause: Cause, account: Account) -> None:
    """Each number in a sentence is one of the cause's within its rounding, or a constant that is
    stated.
    """
    for words in (cause.reason, cause.who, cause.decision):
        sentence = sentence.replace(words, "") if words else sentence
    numbers = [
        float(value) for value in re.findall(r"-?\d+(?:\.\d+)?", sentence.replace("m/s²", ""))
    ]
    values = [getattr(cause, item.name) for item in fields(cause)]
    there = [float(v) for v in values if isinstance(v, float) and isfinite(v)]
    there += [GAP_M, HEADWAY_S, account.t + account.course.t_brakes, 0.05, LOOK_S]
    for number in numbers:
        assert any(
            abs(number - value) <= (0.5 if number == round(number) else 0.0501) for value in there
        ), sentence


def check_drive(name: str, planner: str, mode: str, until: float = 1e9) -> list[Account]:
    world = CATALOGUE[name].scenario()
    trace = LOOPS[mode](world, planner, config=TRUSTED).trace
    trace = replace(trace, frames=tuple(frame for frame in trace.frames if frame.t <= until)[::4])
    found, ways = list(accounts(trace, world)), Ways(world)
    for case, account in zip(planner_inputs(trace, world), found, strict=True):
        check(case, account, world, ways)
    return found


@pytest.mark.parametrize(
    ("name", "planner", "mode"),
    [
        ("paper/crossing_pedestrian", "dp_qp", "closed"),
        ("everyday/traffic_light", "idm", "open"),
        ("paper/free_road", "lattice", "open"),
        ("paper/crossing_pedestrian", f"{__name__}:SlowDown", "open"),
    ],
)
def test_no_sentence_contradicts_the_numbers(name: str, planner: str, mode: str) -> None:
    assert any(account.causes for account in check_drive(name, planner, mode))


PAIRS = enumerate(product(CATALOGUE, [*PLANNER.causal, f"{__name__}:SlowDown"]))


@pytest.mark.slow
# Every planner and scenario
@pytest.mark.parametrize(("name", "planner"), [pair for i, pair in PAIRS if i % 5 == 0])
def test_no_sentence_contradicts_the_numbers_anywhere(name: str, planner: str) -> None:
    for mode in LOOPS:
        check_drive(name, planner, mode)


# --------------------------------------------------------------------------------------------------
# by hand


def world_with(*others: dict[str, object], speed: float = 10.0, **more: object) -> Scenario:
    """An ego along x from 0 on, at a speed, for a second; the road goes on for 200 m."""
    ego = drive(straight, speed, 1.0)
    made = scenario(ego, road=lanes_along(drive(straight, 10.0, 1.0), beyond=200.0), **more)  # type: ignore[arg-type]
    return replace(made, tracks=tracks(*others)) if others else made


def why_of(world: Scenario, plan: Plan, wanted: float = nan) -> Account:
    """Why this plan is made of the first frame, and is not as fast as wanted."""
    trace = run_open_loop(world, f"{__name__}:SlowDown", config=TRUSTED).trace
    (first, *_) = trace.frames
    (case,) = planner_inputs(replace(trace, frames=(replace(first, plan=plan),)), world)
    return Explainer(world).account(case, wanted)


def steady(world: Scenario) -> Plan:
    """Straight on at the speed of the log."""
    t, first = np.linspace(0.0, 8.0, 81), world.ego.state(0)
    return Plan(
        Trajectory(t, first.x + first.v * t, 0.0 * t, 0.0 * t, first.v + 0.0 * t, 0.0 * t, 0.0 * t)
    )


@pytest.mark.parametrize(
    ("away", "drives", "limit", "kind"),
    [
        (40.0, 0.0, nan, CauseKind.AGENT),
        (20.0, 15.0, nan, CauseKind.AGENT),
        (inf, 0.0, nan, CauseKind.NONE),
        (inf, 0.0, 10.0, CauseKind.LIMIT),
    ],
)
def test_why_a_steady_plan_is_not_faster_is_asked_where_a_speed_is_wanted(
    away: float, drives: float, limit: float, kind: CauseKind
) -> None:
    """At the wanted 15 m/s a car that stands is met, and one as fast is followed by less than 2 s;
    at 2.5 m/s not.
    """
    t = np.array([0.0, 1.0])
    ahead = track("ahead", t, away + drives * t, 0.0 * t, vx=drives + 0.0 * t, vy=0.0 * t)
    others = (ahead,) if isfinite(away) else ()
    world = world_with(*others, speed=2.5)
    lanes = {i: replace(lane, speed_limit=limit) for i, lane in world.road.lanes.items()}
    world = replace(world, road=replace(world.road, lanes=lanes))
    assert not why_of(world, steady(world)).causes
    first = why_of(world, steady(world), 15.0).causes[0]
    assert first.kind is kind and first.hold_mps == 15.0 and first.is_met == (away == 40.0)
    assert first.who == ("ahead" if others else "") and (
        kind is not CauseKind.LIMIT or first.value == limit
    )


def braking(world: Scenario, internals: tuple[Decision, ...] = ()) -> Plan:
    """SlowDown's first plan."""
    plan = run_open_loop(world, f"{__name__}:SlowDown", config=TRUSTED).trace.frames[0].plan
    return replace(plan, internals=internals)


def test_a_car_ahead_is_an_inferred_cause() -> None:
    """10 m/s, rear bumper at 30 - 2.25: the front, at the axle's distance, is within 2 m after so
    much road.
    """
    world = world_with(track("stopped", [0.0], [30.0], [0.0], static=True))
    account = why_of(world, braking(world))
    (cause,) = account.causes
    rear = 30.0 - 0.5 * world.tracks.length[0]
    room = rear - world.vehicle.axle_to_front
    assert (cause.kind, cause.who, cause.inferred) == (CauseKind.AGENT, "stopped", True)
    assert cause.away_m == pytest.approx(room, abs=0.05)
    assert cause.time_s == pytest.approx((room - 2.0) / 10.0, abs=0.1)
    assert cause.need_mps2 == pytest.approx(100.0 / (2.0 * (room - 2.0)), rel=0.05)
    assert sentences(account)[0].startswith("Slows down for stopped (inferred): ")


def test_a_decision_with_numbers_is_one_cause() -> None:
    world = world_with(track("stopped", [0.0], [30.0], [0.0], static=True))
    stop = Decision("stopped", DecisionKind.STOP, "speed", "stands in the lane")
    said = sentences(why_of(world, braking(world, (stop,))))
    assert said[0].startswith("Slows down for stopped (stop): stands in the lane; ")


@pytest.mark.parametrize("kind", [DecisionKind.YIELD, DecisionKind.STOP, DecisionKind.FOLLOW])
def test_a_decision_about_an_agent_far_from_the_path_is_no_cause(kind: DecisionKind) -> None:
    world = world_with(track("aside", [0.0], [30.0], [12.0], static=True))
    (cause,) = why_of(
        world, braking(world, (Decision("aside", kind, "speed", "for no reason"),))
    ).causes
    assert cause.kind is CauseKind.NONE and not cause.who


def test_a_decision_about_an_agent_near_the_path_is_a_cause() -> None:
    world = world_with(track("waits", [0.0], [30.0], [3.2], static=True))
    may = Decision("waits", DecisionKind.YIELD, "speed", "may step out")
    said = sentences(why_of(world, braking(world, (may,))))
    assert said == ["Slows down for waits (yield): may step out; a decision of the planner alone."]


@pytest.mark.parametrize(
    ("x", "y", "hard"),
    [(-1.0, 2.4, True), (-1.0, 2.4, False), (-1.0, 6.0, True), (-9.0, 2.4, True)],
)
def test_a_followed_agent_beside_the_ego_explains_hard_braking(
    x: float, y: float, hard: bool
) -> None:
    """Whoever is beside is not met: they are behind the middle of the ego."""
    world = world_with(track("beside", [0.0], [x], [y], static=True))
    plan = braking(world, (Decision("beside", DecisionKind.FOLLOW, "speed", "comes in"),))
    path = plan.trajectory
    plan = (
        replace(plan, trajectory=replace(path, a=np.where(path.v > 0.0, -9.0, 0.0)))
        if hard
        else plan
    )
    first = why_of(world, plan).causes[0]
    near = hard and (x, y) == (-1.0, 2.4)
    assert (first.kind is CauseKind.WORD and first.who == "beside" and not first.inferred) == near
    assert not near or first.away_m == pytest.approx(
        y - 0.5 * world.vehicle.width - 0.5 * world.tracks.width[0]
    )


@pytest.mark.parametrize(("y", "kind"), [(3.2, CauseKind.WORD), (12.0, CauseKind.NONE)])
def test_an_overtaken_agent_is_inferred_without_other_causes(y: float, kind: CauseKind) -> None:
    world = world_with(track("walks", [0.0], [30.0], [y], static=True))
    account = why_of(
        world,
        braking(world, (Decision("walks", DecisionKind.OVERTAKE, "speed", "steps out later"),)),
    )
    (cause,) = account.causes
    assert cause.kind is kind and cause.inferred
    said = (
        "Slows down for walks (inferred; the planner decided: overtake): steps out later; near "
        "its way, but not met"
    )
    assert (sentences(account) == [f"{said} at 10.0 m/s."]) is (kind is CauseKind.WORD)


def test_a_conflict_is_stated_once() -> None:
    why = "car 3 goes first: takes it from 2.0 s on, the ego would from 1.0 s to 4.0 s"
    lane, car = (
        Cause(CauseKind.STOP, "lane 5", "yield", why, False),
        Cause(CauseKind.AGENT, "car 3"),
    )
    course = Course(PlanAction.SLOWS, 8.0, 0.0, 0.0, 8.0, 8.0, -1.0, 0.0, 0.0)
    numbers = (("2", "0"), 3), (("3", "4"), 2)
    for others, worded in (
        (("car 3",), 1),
        (("car 33",), 2),
        (("3", "car"), 2),
        (("car 3", "b"), 2),
        *numbers,
    ):
        account = Account(0.0, course, True, (lane, *(replace(car, who=who) for who in others)))
        assert len(conflicts(account)) == len(sentences(account)) == worded
        assert {"3", "car 3"}.isdisjoint(cause.who for cause in conflicts(account))


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0.0, 1e6)), min_size=1, max_size=8))
def test_the_listed_cost_terms_sum_to_the_cost(terms: list[tuple[str, float]]) -> None:
    total, worded = sum(value for _, value in terms), sum(value for _, value in main_terms(terms))
    assert abs(total - worded) <= len(terms) * max(NOISE, SHOWS * total)
    assert main_terms([(name, 1e-9 * value / 1e6) for name, value in terms]) == []
    beside = main_terms([*terms, ("blocked", inf), ("bug", nan)])
    assert [name for name, _ in beside] == [
        *(name for name, _ in main_terms(terms)),
        "blocked",
        "bug",
    ]


def test_unexplained_braking_has_no_cause() -> None:
    world = world_with()
    (said,) = sentences(why_of(world, braking(world)))
    assert said.startswith("Slows down; no cause found: at 10.0 m/s it would meet no road user")


def test_a_red_light_is_a_cause_a_green_one_is_not() -> None:
    line = StopLine(7, 1, np.array([[40.0, 2.0], [40.0, -2.0]]), light=3)
    for colour, kind in ((Colour.RED, CauseKind.STOP), (Colour.GREEN, CauseKind.NONE)):
        world = world_with()
        lane = next(iter(world.road.lanes))
        road = replace(world.road, stop_lines=(replace(line, lane=lane),))
        world = replace(world, road=road, lights=(TrafficLight(3, np.array([0.0]), (colour,)),))
        (cause,) = why_of(world, braking(world)).causes
        assert cause.kind is kind
        if kind is CauseKind.STOP:
            assert cause.who == "stop line 7"
            assert cause.distance_m == pytest.approx(40.0 - world.vehicle.axle_to_front, abs=0.01)


def test_a_lower_limit_is_a_cause_with_what_it_asks_for() -> None:
    world = world_with(speed=10.0)
    lanes = {i: replace(lane, speed_limit=6.0) for i, lane in world.road.lanes.items()}
    (cause,) = why_of(replace(world, road=replace(world.road, lanes=lanes)), braking(world)).causes
    assert (cause.kind, cause.value) == (CauseKind.LIMIT, pytest.approx(6.0))
    assert cause.need_mps2 == pytest.approx((100.0 - 36.0) / (2.0 * 10.0)), "within a second"


def test_a_curve_is_a_cause_where_the_speed_is_too_much_for_it() -> None:
    """The way of a plan that is itself a circle: 10 m/s on 20 m is 5 m/s2 across."""
    world = world_with()
    t = np.linspace(0.0, 8.0, 81)
    s = np.minimum(10.0 * t - 0.5 * t**2, 31.0)
    v = np.maximum(10.0 - t, 0.0)
    x, y = 20.0 * np.sin(s / 20.0), 20.0 * (1.0 - np.cos(s / 20.0))
    plan = Plan(Trajectory(t, x, y, s / 20.0, v, np.full(81, -1.0), np.full(81, 0.05)))
    kinds = {cause.kind: cause for cause in why_of(world, plan).causes}
    assert kinds[CauseKind.CURVE].value == pytest.approx(5.0)
    assert kinds[CauseKind.CURVE].value > CURVE_MPS2


def test_the_goal_is_a_cause_of_a_stop_at_it() -> None:
    world = world_with(goal=Goal((square(27.0, 0.0, 4.0),)), speed=7.0)
    (cause,) = why_of(world, braking(world)).causes
    assert (cause.kind, cause.who) == (CauseKind.GOAL, "place")


@pytest.mark.parametrize(("end", "kind"), [(60.0, CauseKind.GOAL), (400.0, CauseKind.NONE)])
def test_the_goals_time_is_a_cause_where_its_region_ends_before(
    end: float, kind: CauseKind
) -> None:
    """At 10 m/s from 0 s on: 60 m are passed long before 60 s, 400 m are not looked at."""
    region = np.array([[-5.0, -3.0], [end, -3.0], [end, 3.0], [-5.0, 3.0]])
    world = world_with(goal=Goal((region,), t=(60.0, 70.0)))
    (cause,) = why_of(world, braking(world)).causes
    assert cause.kind is kind


def straight_on(v: FloatArray, a: FloatArray) -> Plan:
    """Along x for 8 s."""
    t = np.linspace(0.0, 8.0, 81)
    s = np.r_[0.0, np.cumsum(0.05 * (v[1:] + v[:-1]))]
    return Plan(Trajectory(t, s, 0.0 * t, 0.0 * t, v, a, 0.0 * t))


@pytest.mark.parametrize(
    ("accel", "action"),
    [(0.0, PlanAction.HOLDS), (-0.5, PlanAction.SPEEDS), (0.5, PlanAction.SLOWS)],
)
def test_a_plan_in_reverse_does_not_stand(accel: float, action: PlanAction) -> None:
    v = -4.0 + accel * np.linspace(0.0, 8.0, 81)
    account = why_of(world_with(), straight_on(v, np.full(81, accel)))
    assert (account.course.action, sentences(account)) == (action, [])


@pytest.mark.parametrize(("until", "kind"), [(2.0, CauseKind.BEGUN), (6.0, CauseKind.NONE)])
def test_a_plan_that_brakes_to_a_stop_does_not_release(until: float, kind: CauseKind) -> None:
    t = np.linspace(0.0, 8.0, 81)
    plan = straight_on(6.0 - np.minimum(t, until), np.where(t < until, -1.0, 0.0))
    (cause,) = why_of(world_with(speed=6.0), plan).causes
    assert cause.kind is kind


def test_a_standing_plan_is_explained_by_an_agent_it_would_meet() -> None:
    world = world_with(track("queue", [0.0], [8.0], [0.0], static=True), speed=0.0)
    (said,) = sentences(why_of(world, braking(world)))
    assert (
        said.startswith("Stands for queue (inferred): ")
        and "driving off it would come within 2 m" in said
    )


@settings(max_examples=8)
@given(st.floats(4.0, 20.0), st.floats(12.0, 80.0), st.floats(0.0, 8.0))
def test_braking_as_much_as_is_needed_stays_behind(
    speed: float, ahead: float, theirs: float
) -> None:
    """An agent that goes on along the lane: with `need` the ego never comes nearer than the gap,
    with less it does.
    """
    t = np.arange(0.0, 1.01, 0.1)
    still = [0.0] * len(t)
    lead = track(
        "lead", t.tolist(), (ahead + theirs * t).tolist(), still, vx=[theirs] * len(t), vy=still
    )
    world = world_with(lead, speed=speed)
    (cause, *_) = why_of(world, braking(world)).causes
    if not (cause.is_met and cause.need_mps2 > 0.05):
        return
    t = np.arange(0.0, LOOK_S, 0.1)
    room = ahead + theirs * t - 0.5 * world.tracks.length[0] - world.vehicle.axle_to_front

    def least(decel: float) -> float:
        s = np.where(t < speed / decel, speed * t - 0.5 * decel * t**2, 0.5 * speed**2 / decel)
        return float((room - s).min())

    assert GAP_M - 0.1 <= least(cause.need_mps2) <= GAP_M + 0.5
    assert least(0.8 * cause.need_mps2) < least(cause.need_mps2)


def test_a_drive_read_from_its_file_has_the_same_causes() -> None:
    world = CATALOGUE["paper/crossing_pedestrian"].scenario()
    trace = run_closed_loop(world, "constant_speed").trace
    frames = tuple(replace(frame, plan=braking_from(frame.plan)) for frame in trace.frames[::10])
    trace = replace(trace, frames=frames)
    thinned = replace(
        trace, frames=tuple(replace(frame, predictions=None, agents=()) for frame in frames)
    )
    of_file, of_drive = accounts(thinned, world, LoopConfig()), accounts(trace, world)
    assert repr(list(of_file)) == repr(list(of_drive))  # a NaN is not equal to itself


def braking_from(plan: Plan) -> Plan:
    """A plan that brakes with 1 m/s2 along another's path."""
    path = plan.trajectory
    v = np.maximum(path.v[0] - (path.t - path.t[0]), 0.0)
    return replace(plan, trajectory=replace(path, v=v, a=np.where(v > 0.0, -1.0, 0.0)))
