"""The loops: why a drive ends, that it is the same twice, and that the log's own plan has no
error.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from handmade import drive, lanes_along, s_curve, scenario, square, straight, track, tracks
from hypothesis import given, settings, strategies as st

from replan.core.errors import ConfigError, LogError
from replan.logs.agents import AgentKind
from replan.logs.catalogue import CATALOGUE
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Artefact, CostTerms, Internals, Plan, PlanStatus, SolverReport
from replan.logs.readers.commonroad import read_commonroad
from replan.logs.road import Goal, Lane, Road, RoadSource
from replan.logs.scenario import Scenario
from replan.logs.shapes import overlap
from replan.logs.states import TRAJECTORY_COLUMNS, EgoState, Trajectory
from replan.logs.trace import EndReason, Mode, Trace
from replan.logs.vehicle import VehicleParameters
from replan.metrics.collisions import contacts
from replan.planners.constant_speed import ConstantSpeed
from replan.replay.drive import Drive, Stopwatch
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.contacts import contact
from replan.replay.loop.open_loop import frame_times, run_open_loop
from replan.replay.loop_config import LoopConfig, PlannerProcessConfig
from replan.replay.world import World, box_center, logged_ego

BY_TIME = LoopConfig(traffic="time")
TRUSTED = LoopConfig(apart=PlannerProcessConfig(trust=True))  # so that tests can see into planners
Run = Callable[..., Drive]
RUNS = (run_open_loop, run_closed_loop)
CAR = VehicleParameters()


@pytest.fixture
def plugin() -> Iterator[ModuleType]:
    """A module of the user's: what a test puts there is loaded as `plugin:NAME`."""
    module = sys.modules["plugin"] = ModuleType("plugin")
    yield module
    del sys.modules["plugin"]


def assert_same(one: Trajectory, two: Trajectory) -> None:
    for field in fields(Trajectory):
        np.testing.assert_array_equal(
            getattr(one, field.name), getattr(two, field.name), err_msg=field.name
        )


def lasting(ego: Trajectory, seconds: float, **more: object) -> Scenario:
    """A drive whose log goes on after its ego's, with a goal that is never reached."""
    return scenario(ego, duration=seconds, goal=Goal((square(-1e4, 0.0, 1.0),)), **more)


# --- the same twice, and the form of a trace


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("name", ["constant_speed", "logged"])
def test_two_runs_are_identical(run: Run, name: str) -> None:
    made = scenario(drive(s_curve, 12.0, 6.0))
    one, two = run(made, name).trace, run(made, name).trace
    assert_same(one.ego, two.ego)
    assert len(one.frames) == len(two.frames)
    for a, b in zip(one.frames, two.frames, strict=True):
        assert_same(a.plan.trajectory, b.plan.trajectory)
    assert (one.end, one.detail, one.notes) == (two.end, two.detail, two.notes)


def test_a_closed_loop_is_written_down_at_the_control_rate() -> None:
    drive_ = run_closed_loop(lasting(drive(straight, 10.0, 3.0), 3.0), "constant_speed")
    trace = drive_.trace
    assert (trace.mode, trace.end, trace.oracle) == (Mode.CLOSED, EndReason.END_OF_LOG, False)
    np.testing.assert_array_equal(trace.ego.t, np.arange(301) * 10_000_000 / 1e9)
    np.testing.assert_array_equal(
        [frame.t for frame in trace.frames], np.arange(30) * 100_000_000 / 1e9
    )
    for columns in (trace.commands, trace.actuation, trace.tracking):
        assert columns is not None
        for field in fields(columns):
            assert len(getattr(columns, field.name)) == 301
            assert np.isfinite(getattr(columns, field.name)).all()
    totals = [timing for timing in drive_.timings if timing.stage == "total"]
    assert [timing.t for timing in totals] == [frame.t for frame in trace.frames]
    assert {timing.stage for timing in drive_.timings} == {"arc", "total"}
    assert all(timing.seconds > 0.0 for timing in drive_.timings)


def test_an_open_loop_has_the_logged_states_on_the_grid() -> None:
    log = drive(s_curve, 12.0, 6.0)
    trace = run_open_loop(scenario(log), "constant_speed").trace
    assert (trace.mode, trace.end, trace.commands, trace.tracking) == (
        Mode.OPEN,
        EndReason.END_OF_LOG,
        None,
        None,
    )
    assert_same(trace.ego, log)
    assert len(trace.frames) == 61


def test_frame_previous_is_the_plan_being_driven(plugin: ModuleType) -> None:
    seen: list[tuple[Plan | None, Plan]] = []

    class Remembers(ConstantSpeed):
        def plan(self, frame: Frame) -> Plan:
            plan = super().plan(frame)
            seen.append((frame.previous, plan))
            return plan

    plugin.Remembers = Remembers  # type: ignore[attr-defined]
    made = scenario(drive(straight, 10.0, 1.0))
    run_closed_loop(made, "plugin:Remembers", config=TRUSTED)
    assert [a for a, _ in seen] == [None, *(b for _, b in seen[:-1])]
    seen.clear()
    run_open_loop(made, "plugin:Remembers", config=TRUSTED)
    assert {a for a, _ in seen} == {None}


@pytest.mark.parametrize("run", RUNS)
def test_internals_are_built_only_where_they_are_kept_and_not_carried_on(
    plugin: ModuleType, run: Run
) -> None:
    built: list[float] = []
    before: list[Plan | None] = []
    report = SolverReport("path QP", True, "solved", 3, 0.0, 0.0)

    class Shows(ConstantSpeed):
        def plan(self, frame: Frame) -> Plan:
            before.append(frame.previous)

            def build() -> tuple[Artefact, ...]:
                built.append(frame.t)
                return report, CostTerms("path DP", (("road", frame.t),))

            return replace(super().plan(frame), internals=Internals((report,), build))

    plugin.Shows = Shows  # type: ignore[attr-defined]
    made = scenario(drive(straight, 10.0, 1.0))
    unseen = run(made, "plugin:Shows", config=TRUSTED, keep_internals=False).trace
    assert not built and {frame.plan.internals for frame in unseen.frames} == {(report,)}
    seen = run(made, "plugin:Shows", config=TRUSTED).trace
    assert built == [frame.t for frame in seen.frames] and all(
        len(frame.plan.internals) == 2 for frame in seen.frames
    )
    assert all(
        isinstance(plan.internals, tuple) for plan in before if plan is not None
    )  # else each holds the one before


def test_a_planner_drives_the_same_whether_its_internals_are_kept() -> None:
    made = CATALOGUE["paper/crossing_pedestrian"].scenario()
    seen, unseen = (
        run_closed_loop(made, "dp_qp", keep_internals=keep).trace for keep in (True, False)
    )
    assert all(
        getattr(seen.ego, name).tobytes() == getattr(unseen.ego, name).tobytes()
        for name in TRAJECTORY_COLUMNS
    )
    for one, two in zip(seen.frames, unseen.frames, strict=True):
        reports = [item for item in one.plan.internals if isinstance(item, SolverReport)]
        assert reports == list(two.plan.internals) and len(reports) < len(one.plan.internals)


def test_periods_are_as_configured_and_must_fit() -> None:
    config = LoopConfig(plan_period_s=0.2, control_period_s=0.02, prediction_horizon_s=4.0)
    trace = run_closed_loop(
        lasting(drive(straight, 10.0, 2.0), 2.0), "constant_speed", config=config
    ).trace
    assert len(trace.ego) == 101 and len(trace.frames) == 10
    with pytest.raises(ConfigError, match="multiple"):
        LoopConfig(plan_period_s=0.1, control_period_s=0.03)
    with pytest.raises(ConfigError, match="control_period_s"):
        LoopConfig(control_period_s=0.0)
    with pytest.raises(ConfigError, match="prediction_step_s"):
        LoopConfig(prediction_step_s=1e-9)
    with pytest.raises(ConfigError, match=r"gives more than 1000 samples in loop\.prediction_hor"):
        LoopConfig(prediction_horizon_s=1e5)
    with pytest.raises(ConfigError, match="did you mean 'kinematic_bicycle'"):
        run_closed_loop(
            scenario(drive(straight, 10.0, 2.0)),
            "logged",
            config=LoopConfig(vehicle="kinematic_bike"),
        )


# --- the oracle


def open_loop_error(made: Scenario) -> float:
    """Largest distance between the plans of `logged` and the log, m."""
    worst = 0.0
    for frame in run_open_loop(made, "logged").trace.frames:
        way = frame.plan.trajectory
        inside = way.t <= made.ego.t[-1] + 1e-9
        t = np.union1d(way.t[inside], np.linspace(way.t[0], min(way.t[-1], made.ego.t[-1]), 23))
        for at in t:
            one, two = way.at(float(at)), made.ego.at(float(at))
            worst = max(
                worst,
                abs(one.x - two.x),
                abs(one.y - two.y),
                abs(one.yaw - two.yaw),
                abs(one.v - two.v),
            )
    return worst


@pytest.mark.parametrize("step", [0.01, 0.04, 0.1, 0.25])
def test_logged_has_no_open_loop_error_on_any_sampling(step: float) -> None:
    assert open_loop_error(scenario(drive(s_curve, 12.0, 4.0, step=step))) < 1e-9


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_logged_has_no_open_loop_error_on_ragged_noisy_logs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 40))
    t = rng.uniform(0.0, 5.0) + np.cumsum(rng.uniform(0.005, 0.3, n))
    x = np.cumsum(rng.uniform(0.2, 2.0, n))
    log = Trajectory(
        t, x, rng.normal(0, 0.1, n), rng.normal(0, 0.1, n), rng.uniform(0, 9, n), 0 * t, 0 * t
    )
    road = lanes_along(drive(straight, 10.0, 12.0))
    assert open_loop_error(scenario(log, road=road)) < 1e-9


@pytest.mark.parametrize("run", RUNS)
def test_a_log_of_one_sample_is_carried_on_and_says_so(run: Run) -> None:
    start = drive(straight, 8.0, 1.0).between(0.0, 0.0)
    road = lanes_along(drive(straight, 10.0, 12.0))
    trace = run(scenario(start, road=road, duration=5.0), "logged").trace
    assert trace.end is EndReason.END_OF_LOG
    assert len(trace.frames) == (1 if trace.mode is Mode.OPEN else 50)
    assert all("the log has ended" in frame.plan.reason for frame in trace.frames)
    assert trace.ego.x[-1] == pytest.approx(0.0 if trace.mode is Mode.OPEN else 40.0, abs=0.2)
    assert (
        run(scenario(start, road=road, duration=5.0), "constant_speed").trace.end
        is EndReason.END_OF_LOG
    )


def test_a_log_without_time_is_refused() -> None:
    start = drive(straight, 8.0, 1.0).between(0.0, 0.0)
    with pytest.raises(LogError, match="nothing to drive"):
        run_closed_loop(
            scenario(start, road=lanes_along(drive(straight, 9.0, 9.0)), duration=0.0), "logged"
        )


def test_a_log_that_starts_late_starts_late() -> None:
    log = drive(straight, 10.0, 5.0)
    late = replace(scenario(log), ego=log.between(1.95, 5.0))
    for run in RUNS:
        assert run(late, "constant_speed").trace.ego.t[0] == pytest.approx(2.0)
    assert frame_times(late.ego, 100_000_000)[-1] == pytest.approx(5.0)


def test_between_two_samples_the_ego_is_the_earlier_one_carried_on() -> None:
    log = drive(straight, lambda t: np.where(t < 1.0, 10.0, 20.0), 2.0, step=1.0)
    state = logged_ego(log, CAR, 0.7)
    assert (state.t, state.x, state.v) == (0.7, pytest.approx(7.0), 10.0)
    shorter = Trajectory(*(getattr(log, field.name)[:1] for field in fields(Trajectory)))
    assert logged_ego(shorter, CAR, 0.7) == replace(state, a=shorter.a[0])


# --- why a drive ends


def crossing(at_x: float, **more: object) -> Scenario:
    """Straight at 10 m/s; somebody stands across the lane."""
    walker = track(
        "7",
        [0.0],
        [at_x],
        [0.0],
        static=True,
        kind=AgentKind.PEDESTRIAN,
        length=0.6,
        width=0.6,
        **more,
    )
    return lasting(drive(straight, 10.0, 8.0), 8.0, agents=tracks(walker))


def test_collision_ends_at_the_touch_and_names_the_agent() -> None:
    trace = run_closed_loop(crossing(50.0), "constant_speed").trace
    assert (trace.end, trace.detail) == (EndReason.COLLISION, "pedestrian 7")
    assert trace.ego.x[-1] + CAR.axle_to_front == pytest.approx(50.0 - 0.3, abs=0.11)


def test_where_a_replayed_car_runs_into_the_ego_the_replay_ends_the_drive() -> None:
    """The log's car does not see an ego that is slower than the log's was."""
    log = drive(straight, 10.0, 8.0)
    behind = track("3", log.t, log.x - 12.0 + 4.0 * log.t, log.y)
    there = track("4", [0.0], [2.0], [0.0], static=True)
    for who, detail in (
        (behind, "car 3: from behind"),
        (there, "car 4: appeared where the ego was"),
    ):
        trace = run_closed_loop(
            lasting(log, 8.0, agents=tracks(who)), "constant_speed", config=BY_TIME
        ).trace
        assert (trace.end, trace.detail) == (EndReason.REPLAY_CONTACT, detail)


def test_one_fault_among_several_touches_is_a_collision() -> None:
    log = drive(straight, 10.0, 8.0)
    meet, rear = 5.005, CAR.length - CAR.axle_to_front
    slow = track("slow", log.t, CAR.axle_to_front + 2.25 + 6.0 * meet + 4.0 * log.t, log.y)
    fast = track("fast", log.t, -rear - 2.25 - 2.0 * meet + 12.0 * log.t, log.y)
    trace = run_closed_loop(
        lasting(log, 8.0, agents=tracks(fast, slow)), "constant_speed", config=BY_TIME
    ).trace
    kinds = {
        (trace.agents.ids[found.agent], found.at_fault)
        for found in contacts(trace, lasting(log, 8.0))
    }
    assert (trace.end, trace.detail) == (EndReason.COLLISION, "car slow")
    assert kinds == {("slow", True), ("fast", False)}


@pytest.mark.slow
@pytest.mark.parametrize("traffic", ["give_way", "time", "reactive"])
def test_on_recorded_logs_the_end_and_the_metric_say_the_same_of_fault(
    shared_data: Path, traffic: str
) -> None:
    ends = set()
    for file in sorted((shared_data / "commonroad").glob("*.xml")):
        log = read_commonroad(file)
        for planner in ("constant_speed", "idm"):
            trace = run_closed_loop(log, planner, config=LoopConfig(traffic=traffic)).trace
            found = contacts(trace, log)
            faults = [contact.at_fault for contact in found]
            assert (trace.end is EndReason.COLLISION) == any(faults), (file.stem, planner)
            assert (trace.end is EndReason.REPLAY_CONTACT) == (bool(faults) and not any(faults)), (
                file.stem,
                planner,
            )
            if trace.end is EndReason.REPLAY_CONTACT:
                assert any(trace.detail.endswith(contact.kind.value) for contact in found)
            ends.add(trace.end)
    assert {EndReason.COLLISION, EndReason.REPLAY_CONTACT} <= ends or traffic != "time"


def test_an_agent_that_is_gone_cannot_be_hit() -> None:
    log = drive(straight, 10.0, 6.0)
    gone = track("1", [0.0, 1.0], [40.0, 40.0], [0.0, 0.0])
    trace = run_closed_loop(lasting(log, 6.0, agents=tracks(gone)), "constant_speed").trace
    assert trace.end is EndReason.END_OF_LOG


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 4.0))
def test_contact_is_with_the_agents_as_they_truly_are(seed: int, t: float) -> None:
    rng = np.random.default_rng(seed)
    agents = []
    for i in range(6):
        when = np.sort(rng.uniform(0.0, 4.0, rng.integers(1, 8)))
        x, y, yaw = rng.uniform(-6.0, 6.0, (3, len(when)))
        agents.append(
            track(str(i), when, x, y, yaw=yaw, static=bool(i == 5), length=2.0, width=1.0)
        )
    world = World(EgoState(t, 0.0, 0.0, float(rng.uniform(-3, 3)), 0.0), tracks(*agents))
    truth = world.tracks.truth(t)
    x, y = box_center(world.ego, CAR)
    touching = [
        ident
        for ident, *box in zip(
            truth.ids, truth.x, truth.y, truth.yaw, truth.length, truth.width, strict=True
        )
        if overlap(x, y, world.ego.yaw, CAR.length, CAR.width, *map(float, box))
    ]
    hit = contact(world, CAR)
    assert (world.tracks.ids[hit] if hit >= 0 else None) == (touching[0] if touching else None)


def test_without_a_goal_it_is_where_the_drive_ended(plugin: ModuleType) -> None:
    goals: list[Goal | None] = []

    class Asks(ConstantSpeed):
        def __init__(self, context: PlannerContext) -> None:
            goals.append(context.goal)
            super().__init__(context)

    plugin.Asks = Asks  # type: ignore[attr-defined]
    trace = run_closed_loop(
        scenario(drive(straight, 10.0, 5.0)), "plugin:Asks", config=TRUSTED
    ).trace
    assert trace.end is EndReason.GOAL and trace.ego.x[-1] == pytest.approx(47.5, abs=0.11)
    assert any("where its drive ended" in note for note in trace.notes)
    stays = scenario(drive(straight, 0.5, 5.0), road=lanes_along(drive(straight, 10.0, 5.0)))
    assert run_closed_loop(stays, "plugin:Asks", config=TRUSTED).trace.end is EndReason.END_OF_LOG
    run_open_loop(scenario(drive(straight, 10.0, 5.0)), "plugin:Asks", config=TRUSTED)
    assert goals[0] is not None and goals[0].holds_place(50.0 + CAR.axle_to_center, 0.0)
    assert goals[1] is None and goals[2] is not None


def test_off_road_is_judged_by_lanes_only() -> None:
    ahead = drive(straight, 10.0, 8.0)
    bend = drive(s_curve, 10.0, 8.0)
    along_bend = run_closed_loop(
        lasting(ahead, 8.0, road=lanes_along(bend)), "constant_speed"
    ).trace
    assert along_bend.end is EndReason.OFF_ROAD
    assert "off the lanes at (" in along_bend.detail
    driven = Road.along(np.column_stack([bend.x, bend.y]), speed_limit=10.0)
    assert driven.source is RoadSource.DRIVEN_PATH
    trace = run_closed_loop(lasting(ahead, 8.0, road=driven), "constant_speed").trace
    assert trace.end is EndReason.END_OF_LOG
    assert any("not judged" in note for note in trace.notes)


@pytest.mark.parametrize("run", RUNS)
def test_on_the_driven_path_the_planner_knows_the_way_and_that_is_said(run: Run) -> None:
    bend = drive(s_curve, 10.0, 8.0)
    driven = Road.along(np.column_stack([bend.x, bend.y]), speed_limit=10.0)
    for road, known in ((driven, True), (lanes_along(bend), False)):
        trace = run(scenario(bend, road=road), "constant_speed").trace
        assert any("knows where the log's driver went" in note for note in trace.notes) == known


def test_a_crack_between_two_lanes_is_no_edge() -> None:
    def lane(ident: int, x: float) -> Lane:
        return Lane(
            ident, np.array([[x, 2.0], [x + 30.0, 2.0]]), np.array([[x, -2.0], [x + 30.0, -2.0]])
        )

    road = Road({0: lane(0, -5.0), 1: lane(1, 25.1), 2: lane(2, 57.0)})
    trace = run_closed_loop(
        lasting(drive(straight, 10.0, 8.0), 8.0, road=road), "constant_speed"
    ).trace
    assert trace.end is EndReason.OFF_ROAD
    assert trace.ego.x[-1] + CAR.axle_to_center == pytest.approx(55.6, abs=0.11)


def test_who_starts_off_the_lanes_is_judged_once_on_them() -> None:
    lane = Lane(0, np.array([[20.0, 2.0], [50.0, 2.0]]), np.array([[20.0, -2.0], [50.0, -2.0]]))
    trace = run_closed_loop(
        lasting(drive(straight, 10.0, 8.0), 8.0, road=Road({0: lane})), "constant_speed"
    ).trace
    assert trace.end is EndReason.OFF_ROAD and trace.ego.x[-1] > 48.0
    assert any("starts off the lanes" in note for note in trace.notes)


# --- planners that fail


class Raises(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        if frame.t > 0.55:
            raise ValueError("no way\nahead")
        return super().plan(frame)


class ReturnsNone(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        return None  # type: ignore[return-value]


class StartsLate(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        return super().plan(replace(frame, t=frame.t + 0.5))


class NotFinite(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        return super().plan(replace(frame, ego=replace(frame.ego, x=float("nan"))))


class Silent(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        return replace(super().plan(frame), status=PlanStatus.HARD_STOP)


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize(
    ("broken", "said", "frames"),
    [
        (Raises, "raised at 0.60 s: ValueError: no way ahead (test_loops.py:", 6),
        (ReturnsNone, "returned NoneType instead of a Plan", 0),
        (StartsLate, "starts at 0.500 s, not at the frame's time", 0),
        (NotFinite, "x is not finite", 0),
        (Silent, "without a reason", 0),
    ],
)
def test_a_planner_that_fails_ends_a_drive(
    plugin: ModuleType, run: Run, broken: type, said: str, frames: int
) -> None:
    plugin.Broken = broken  # type: ignore[attr-defined]
    trace: Trace = run(
        lasting(drive(straight, 10.0, 3.0), 3.0), "plugin:Broken", config=TRUSTED
    ).trace
    assert trace.end is EndReason.PLANNER_FAILURE
    assert said in trace.detail and "\n" not in trace.detail
    assert "plugin:Broken" in trace.detail and "handmade" in trace.detail
    assert len(trace.frames) == frames
    if trace.mode is Mode.CLOSED:
        assert (
            trace.commands is not None and len(trace.ego) == len(trace.commands) == 10 * frames + 1
        )


# --- no future in a drive


def test_what_the_others_do_later_changes_nothing_before(plugin: ModuleType) -> None:
    """Whoever reacts to all that it sees drives the same until the logs differ."""

    class Nosy(ConstantSpeed):
        def plan(self, frame: Frame) -> Plan:
            bend = 1e-3 * float(np.sin(frame.predictions.y.sum() + frame.agents.x.sum()))
            return super().plan(replace(frame, ego=replace(frame.ego, kappa=bend)))

    plugin.Nosy = Nosy  # type: ignore[attr-defined]
    log = drive(straight, 10.0, 6.0)
    far = 20.0 + np.where(log.t <= 3.0, 0.0, 3.0)
    one = lasting(log, 6.0, agents=tracks(track("a", log.t, log.x, np.full_like(far, 20.0))))
    two = lasting(log, 6.0, agents=tracks(track("a", log.t, log.x + far - 20.0, far)))
    for run in RUNS:
        before, after = (run(each, "plugin:Nosy", config=TRUSTED).trace for each in (one, two))
        for a, b in zip(before.frames, after.frames, strict=True):
            if a.t < 3.05:
                assert_same(a.plan.trajectory, b.plan.trajectory)
        assert not np.array_equal(
            before.frames[-1].plan.trajectory.y, after.frames[-1].plan.trajectory.y
        )


# --- following a plan, and the clock


def test_laps_add_up_and_count_only_while_planning() -> None:
    watch = Stopwatch()
    watch.lap("construction")
    watch.start()
    watch.lap("path")
    watch.lap("speed")
    watch.lap("path")
    watch.lap("total")
    watch.stop(1.5)
    stages = watch.times
    assert [(stage.t, stage.stage) for stage in stages] == [
        (1.5, "path"),
        (1.5, "speed"),
        (1.5, "total"),
    ]
    assert 0.0 <= stages[0].seconds + stages[1].seconds <= stages[2].seconds
