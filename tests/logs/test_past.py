"""The past of a frame: what was known before it, and never what came later."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from replan.logs import catalogue
from replan.logs.agents import AgentKind, Agents
from replan.logs.edit.cut import HISTORY_S, cut
from replan.logs.edit.transform import mirrored, moved
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.mcap.reader import read_scenario
from replan.logs.mcap.writer import write_scenario
from replan.logs.past import PAST_S, PAST_STEP_S, PAST_STEPS, Earlier, Past, PastSource, Snapshot
from replan.logs.plan import Plan
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.logs.trace import Mode
from replan.planners.constant_speed import ConstantSpeed
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop_config import DEFAULT_LOOP, LoopConfig
from replan.replay.perception import Perception
from replan.replay.world import World, logged_ego

COLUMNS = ("x", "y", "yaw", "vx", "vy")
LOG = catalogue.scenario("everyday/cut_in")


def agents_at(t: float, names: tuple[str, ...], speed: float = 2.0) -> Agents:
    """Agents that drive along x, one behind the other."""
    n = len(names)
    x = 10.0 * np.arange(n) + speed * t
    columns = np.full(n, 4.0), np.full(n, 2.0), x, np.zeros(n), np.zeros(n)
    return Agents(names, (AgentKind.CAR,) * n, *columns, np.full(n, speed), np.zeros(n))


def snapshot(t: float, names: tuple[str, ...] = ("a", "b")) -> Snapshot:
    """The ego drives on an arc at 5 m/s."""
    ego = EgoState(0.0, 0.0, 0.0, 0.0, 5.0, kappa=0.1, yaw_rate=0.5).later(t)
    return Snapshot(t, ego, agents_at(t, names), {})


def frames_of(
    scenario: Scenario, times: list[float], loop: LoopConfig = DEFAULT_LOOP
) -> list[Frame]:
    """The frames of the logged drive at these times."""
    perception = Perception(scenario, loop)
    egos = [logged_ego(scenario.whole_ego, scenario.vehicle, t) for t in times]
    return [perception.frame(World(ego, scenario.tracks), None) for ego in egos]


def assert_equal(first: Past, second: Past) -> None:
    assert first.ego == second.ego
    assert first.ids == second.ids
    for name in (*COLUMNS, "t", "seen"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.lights == second.lights


@given(
    st.lists(st.integers(-40, -1), max_size=30, unique=True),
    st.lists(st.sampled_from("abcd"), max_size=4, unique=True),
)
def test_a_past_is_full_and_has_the_agents_of_the_frame_first(
    ticks: list[int], names: list[str]
) -> None:
    known = tuple(snapshot(0.1 * tick, ("b", "c")) for tick in sorted(ticks))
    past = Earlier(known).past(snapshot(0.0, tuple(names)))
    assert len(past) == PAST_STEPS
    np.testing.assert_allclose(past.t, -PAST_STEP_S * np.arange(PAST_STEPS, 0, -1))
    assert past.ids[: len(names)] == tuple(names)
    assert set(past.ids) <= {*names, "b", "c"}
    for column in (past.x, past.y, past.yaw, past.vx, past.vy, past.seen):
        assert column.shape == (PAST_STEPS, len(past.ids))
    assert all(np.isfinite(getattr(past, name)).all() for name in COLUMNS)
    held = [source is PastSource.HELD for source in past.source]
    assert held == sorted(held, reverse=True)
    assert not past.seen[held].any()


@given(st.integers(0, 30))
def test_who_moves_evenly_has_the_same_past_whether_it_was_seen_or_not(known: int) -> None:
    """Velocity and arc are exact: what is held is what was."""
    snapshots = tuple(snapshot(0.1 * tick) for tick in range(-known, 0))
    past = Earlier(snapshots).past(snapshot(0.0))
    for k, t in enumerate(past.t):
        truth = snapshot(float(t))
        np.testing.assert_allclose(past.x[k], truth.agents.x, atol=1e-9)
        assert past.ego[k].x == pytest.approx(truth.ego.x)
        assert past.ego[k].y == pytest.approx(truth.ego.y)
        assert past.ego[k].yaw == pytest.approx(truth.ego.yaw)


def test_an_agent_that_is_gone_is_last_and_not_seen_any_more() -> None:
    known = tuple(
        snapshot(0.1 * tick, ("gone", "a") if tick < -5 else ("a",)) for tick in range(-21, 0)
    )
    past = Earlier(known).past(snapshot(0.0, ("a",)))
    assert past.ids == ("a", "gone")
    assert past.seen[:, 0].all()
    np.testing.assert_array_equal(past.seen[:, 1], past.t < -0.55)


def test_frames_between_the_steps_are_moved_and_later_ones_are_not_used() -> None:
    """A step between two frames is the earlier one, moved."""
    known = tuple(snapshot(t) for t in (-0.75, -0.5, -0.25))
    wild = replace(snapshot(0.0), agents=agents_at(50.0, ("a", "b")))
    past = Earlier(known).past(wild)
    np.testing.assert_allclose(past.x[-1], snapshot(-0.1).agents.x)
    np.testing.assert_allclose(past.x[-3], snapshot(-0.3).agents.x)


@pytest.mark.parametrize("loop", [DEFAULT_LOOP, LoopConfig(plan_period_s=0.2)])
def test_the_past_in_open_loop_is_the_same_for_a_planner_that_saw_no_earlier_frame(
    loop: LoopConfig,
) -> None:
    times = [round(loop.plan_period_s * k, 6) for k in range(12)]
    drive = frames_of(LOG, times, loop)
    for frame in drive:
        (alone,) = frames_of(LOG, [frame.t], loop)
        if loop.plan_period_s == PAST_STEP_S:
            assert_equal(frame.past, alone.past)
        assert frame.past.ids[: len(frame.agents)] == frame.agents.ids


def test_a_log_that_is_cut_has_its_past_and_keeps_it_in_a_file(tmp_path: Path) -> None:
    part = cut(LOG, 3.0)
    assert part.before is not None
    assert part.before.t[0] == pytest.approx(-HISTORY_S)
    write_scenario(tmp_path / "part.mcap", part)
    for scenario in (part, read_scenario(tmp_path / "part.mcap")):
        (first,) = frames_of(scenario, [0.0])
        (whole,) = frames_of(LOG, [3.0])
        past, truth = first.past, whole.past
        assert set(past.source) == {PastSource.LOG}
        np.testing.assert_allclose(past.t, truth.t - 3.0, atol=1e-9)
        assert past.ids == truth.ids
        np.testing.assert_allclose(past.x, truth.x, atol=1e-6)
        np.testing.assert_allclose(
            [state.x for state in past.ego], [state.x for state in truth.ego], atol=1e-6
        )


def test_a_log_without_a_past_holds_its_first_state() -> None:
    (first,) = frames_of(LOG, [0.0])
    past = first.past
    assert set(past.source) == {PastSource.HELD}
    assert not past.seen.any()
    moved_m = np.hypot(past.ego[0].x - first.ego.x, past.ego[0].y - first.ego.y)
    assert moved_m == pytest.approx(PAST_S * first.ego.v, rel=0.01)


@settings(deadline=None, max_examples=10)
@given(st.floats(-3.0, 3.0), st.booleans())
def test_the_past_moves_with_the_world(angle: float, is_mirrored: bool) -> None:
    part = cut(LOG, 3.0)
    turned = moved(mirrored(part) if is_mirrored else part, 5.0, -3.0, angle)
    (frame,), (again,) = frames_of(part, [0.0]), frames_of(turned, [0.0])
    for before, after in zip(frame.past.ego, again.past.ego, strict=True):
        way = np.hypot(before.x - frame.ego.x, before.y - frame.ego.y)
        assert np.hypot(after.x - again.ego.x, after.y - again.ego.y) == pytest.approx(way)
        assert after.v == before.v


class Remembering:
    """Keeps the pasts that it gets; drives straight on."""

    pasts: list[Past]

    def __init__(self, context: PlannerContext) -> None:
        self.pasts = []
        self._planner = ConstantSpeed(context)
        planners.append(self)

    def plan(self, frame: Frame) -> Plan:
        self.pasts.append(frame.past)
        return self._planner.plan(frame)


planners: list[Remembering] = []


@pytest.mark.parametrize("mode", list(Mode))
def test_a_drive_from_the_middle_begins_with_a_real_past(mode: Mode) -> None:
    run = run_closed_loop if mode is Mode.CLOSED else run_open_loop
    planners.clear()
    trusted = replace(DEFAULT_LOOP, apart=replace(DEFAULT_LOOP.apart, trust=True))
    trace = run(cut(LOG, 7.0), f"{__name__}:Remembering", config=trusted, until_s=3.0).trace
    (planner,) = planners
    assert set(planner.pasts[0].source) == {PastSource.LOG}
    assert set(planner.pasts[-1].source) == {PastSource.DRIVE}
    last = planner.pasts[-1]
    driven = [trace.ego.at(float(t)) for t in last.t]
    np.testing.assert_allclose([s.x for s in last.ego], [s.x for s in driven], atol=1e-3)


def test_a_frame_made_by_hand_has_a_past() -> None:
    now = snapshot(0.0)
    none = np.empty((0, 1))
    futures = Predictions(np.zeros(1), np.empty(0, int), np.empty(0), none, none, none, "")
    frame = Frame(0.0, now.ego, now.agents, futures)
    assert len(frame.past) == PAST_STEPS
