"""Lead, headway, required braking and steering, the following gap of UN R157: hand-computed, and
their laws.
"""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from drives import CAR, EGO, NOSE, Agent, along, drive, grid, moved, moving, scenario
from hypothesis import given, settings, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.metrics import GROUPS, evaluate, series
from replan.metrics.following import required_decel, required_gap
from replan.metrics.lead import ahead_of
from replan.metrics.metric import Metric

NEW = (
    "ttc",
    "ttc_vulnerable",
    "collision_severity",
    "headway",
    "thw",
    "drac",
    "required_decel",
    "btn",
    "stn",
    "following_gap",
    "ttc_accelerated",
    "dce",
    "ttce",
    "pet",
    "rss_margin",
    "rss_improper",
)
MINE = {metric.name: metric for metric in GROUPS["safety"] if metric.name in NEW}


def lead(
    gap: float, v: float, decel: float = 0.0, y: float = 0.0, kind: AgentKind = AgentKind.CAR
) -> Agent:
    """`gap` m ahead of the bumper of an ego that starts at 0.

    Brakes from t = 0 on, until it stands.
    """

    def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rolls = np.minimum(t, v / decel) if decel else t
        return NOSE + gap + 2.25 + v * rolls - 0.5 * decel * rolls**2, y + 0 * t, 0 * t

    return "7", kind, CAR, motion


def world(v: float, *agents: Agent, seconds: float = 2.0, **changes: object) -> Scenario:
    return scenario(along(grid(seconds), v, **changes), agents)


def value(log: Scenario, name: str, metrics: dict[str, Metric] = MINE) -> float:
    return float(evaluate(drive(log), log, metrics=metrics).set_index("metric").loc[name, "value"])


def at(log: Scenario, name: str, t: float) -> float:
    """The series `name` at the step t."""
    frames = series(drive(log), log, metrics=MINE)
    rows = frames[(frames["metric"] == name) & np.isclose(frames["t_s"], t)]
    return float(rows["value"].iloc[0])


def test_the_lead_is_the_nearest_in_the_band_and_not_beside_behind_or_oncoming() -> None:
    """Band: 0.805 m to each side.

    A car 1.8 m wide at y = 1.70 reaches to 0.80, at 1.71 only to 0.81.
    """
    behind = ("b", AgentKind.CAR, CAR, moving(-8.0, 0.0, 10.0, 0.0))
    coming = ("c", AgentKind.CAR, CAR, moving(30.0, 0.0, -5.0, 0.0))
    far, near = replace_id(lead(40.0, 10.0), "far"), replace_id(lead(20.0, 10.0, y=1.70), "near")
    aside = replace_id(lead(10.0, 10.0, y=1.71), "aside")
    log = world(10.0, behind, coming, far, aside, near, seconds=0.2)
    found = ahead_of(drive(log), log)
    assert [log.tracks.ids[i] for i in found.agent] == ["near"] * 3
    assert found.gap == pytest.approx(20.0)
    assert found.u == pytest.approx(10.0)
    assert (found.low, found.high) == (pytest.approx(0.80), pytest.approx(2.60))


def replace_id(agent: Agent, name: str) -> Agent:
    return name, *agent[1:]


@given(st.floats(-0.12, 0.12), st.floats(5.0, 60.0), st.floats(-0.75, 0.75))
def test_the_path_bends_with_the_ego(kappa: float, s: float, aside: float) -> None:
    """A small box at (s, l) of a circle is in the band up to a quarter of a turn, at its near
    edge.
    """
    if abs(kappa) < 1e-3 or abs(kappa) * s > 0.5 * pi - 0.05:
        return
    radius, turn = 1.0 / kappa - aside, kappa * s
    x, y = radius * np.sin(turn), 1.0 / kappa - radius * np.cos(turn)
    cone = ("7", AgentKind.OBJECT, (0.02, 0.02), moving(x, y, 0.0, 0.0, turn))
    t = grid(0.1)
    circle = Trajectory(t, 0 * t, 0 * t, 0 * t, 5 + 0 * t, 0 * t, kappa + 0 * t)
    log = scenario(circle, [cone])
    gap = ahead_of(drive(log), log).gap[0]
    scale = abs(1.0 - kappa * aside)
    assert gap == pytest.approx(max(s - 0.01 / scale - NOSE, 0.0), abs=2e-3)


def test_a_crossing_road_user_is_a_lead_while_in_the_band() -> None:
    """0.6 m wide, 1 m/s from y = -2: reaches -0.805 after (2 - 0.805 - 0.3) / 1 = 0.895 s, leaves
    after 3.105 s.
    """
    walker = ("p", AgentKind.PEDESTRIAN, (0.6, 0.6), moving(60.0, -2.0, 0.0, 1.0, 0.0))
    log = world(5.0, walker, seconds=4.0)
    found = ahead_of(drive(log), log)
    assert found.t[found.agent >= 0] == pytest.approx(np.arange(0.9, 3.15, 0.1))


def test_headway_time_headway_and_drac() -> None:
    """The scene of a published library: 15 and 10 m/s, 30 m apart.

    THW = 30/15, DRAC = 25/60; after 1 s 25 m.
    """
    log = world(15.0, lead(30.0, 10.0))
    assert (at(log, "headway", 0.0), at(log, "thw", 0.0)) == (
        pytest.approx(30.0),
        pytest.approx(2.0),
    )
    assert at(log, "drac", 0.0) == pytest.approx(25.0 / 60.0)
    assert at(log, "drac", 1.0) == pytest.approx(25.0 / 50.0)
    assert value(log, "thw.min") == pytest.approx(20.0 / 15.0)
    assert value(log, "btn.max") == pytest.approx(25.0 / 40.0 / EGO.max_decel)


@settings(max_examples=40)
@given(
    st.floats(1.0, 60.0),
    st.floats(1.0, 30.0),
    st.floats(0.0, 30.0),
    st.sampled_from([0.0, 0.5, 2.0, 6.0]),
)
def test_required_deceleration_is_the_least_that_does_not_touch(
    gap: float, v: float, u: float, decel: float
) -> None:
    (least,) = required_decel(np.array([gap]), np.array([v]), np.array([u]), np.array([decel]))
    t = np.linspace(0.0, 80.0, 80_001)

    def way(speed: float, brake: float) -> np.ndarray:
        rolls = np.minimum(t, speed / brake) if brake > 0.0 else t
        return speed * rolls - 0.5 * brake * rolls**2

    def clearance(brake: float) -> float:
        return float(np.min(gap + way(u, decel) - way(v, brake)))

    assert clearance(least) > -1e-3
    if least > 0.05:
        assert clearance(0.97 * least) < 0.0


def test_steering_past_a_standing_car() -> None:
    """10 m/s, 20 m: T = 2 s, the car from -0.9 to 0.9 m: 2 (0.9 + 0.805) / 4 = 0.8525 m/s2,
    over 8.
    """
    log = world(10.0, lead(20.0, 0.0), seconds=0.1)
    assert at(log, "stn", 0.0) == pytest.approx(0.8525 / 8.0)
    # To the right: 0.805 - (0.5 - 0.9) = 1.205
    offset = world(10.0, lead(20.0, 0.0, y=0.5), seconds=0.1)
    assert at(offset, "stn", 0.0) == pytest.approx(2.0 * 1.205 / 4.0 / 8.0)
    # 2 m to the left by then: out
    leaves = ("7", AgentKind.CAR, CAR, moving(NOSE + 22.25, 0.8, 0.0, 1.0, 0.0))
    assert at(world(10.0, leaves, seconds=0.1), "stn", 0.0) == 0.0


def test_the_following_gap_of_r157() -> None:
    """2.0 m at 7.2 km/h, 3.1 at 10, 26.7 at 60; at 35 km/h 9.722 * 1.35 = 13.1; below 2 m/s 2 m."""
    v = np.array([7.2, 10.0, 35.0, 60.0, 90.0, 3.6, 0.0]) / 3.6
    expected = [2.0, 10.0 / 3.6 * 1.1, 35.0 / 3.6 * 1.35, 60.0 / 3.6 * 1.6, 40.0, 2.0, 2.0]
    assert required_gap(v) == pytest.approx(expected)
    log = world(10.0, lead(10.0, 10.0))  # 36 km/h: 1.36 s: 13.6 m; 10 m are 3.6 too few, for 2 s
    assert value(log, "following_gap.min") == pytest.approx(-3.6)
    assert value(log, "following_gap.time_too_near") == pytest.approx(2.0)
    assert value(world(10.0, lead(14.0, 10.0)), "following_gap.time_too_near") == 0.0


@pytest.mark.parametrize(
    "agent",
    [
        lead(10.0, 0.0),
        lead(10.0, 9.0, kind=AgentKind.PEDESTRIAN),
        ("c", AgentKind.CAR, CAR, moving(NOSE + 12.0, -1.0, 0.0, 1.0)),
    ],
    ids=["standing", "pedestrian", "crossing"],
)
def test_pedestrians_oncoming_and_crossing_road_users_are_not_followed(agent: Agent) -> None:
    row = evaluate(drive(log := world(5.0, agent, seconds=0.5)), log, metrics=MINE).set_index(
        "metric"
    )
    assert row.loc["following_gap.min", "reason"] == "the ego followed no vehicle"
    assert row.loc["headway.min", "available"]


def test_an_empty_path_is_no_value_and_no_time() -> None:
    table = evaluate(drive(log := world(10.0)), log, metrics=MINE).set_index("metric")
    values = [name for name in table.index if name.split(".")[-1] in ("min", "max")]
    assert not table.loc[values, "available"].any()
    assert (table.loc[values, "reason"] != "").all()
    times = [name for name in table.index if "time_" in name or "share_" in name]
    # Without other road users there is no TTC at all
    known = table.loc[times, "available"].astype(bool)
    assert (table.loc[times, "value"][known] == 0.0).all()


@settings(max_examples=15)
@given(
    st.integers(0, 40), st.floats(-3.1, 3.1), st.floats(-90, 90), st.floats(-90, 90), st.booleans()
)
def test_a_moved_and_mirrored_world_changes_nothing(
    seed: int, turn: float, dx: float, dy: float, mirror: bool
) -> None:
    log = crowd(seed)
    other = moved(log, turn, dx, dy, mirror=mirror)
    one, two = (series(drive(each), each, metrics=MINE) for each in (log, other))
    assert (one["metric"] == two["metric"]).all()
    assert two["value"].to_numpy() == pytest.approx(one["value"].to_numpy(), abs=1e-6, nan_ok=True)


def crowd(seed: int) -> Scenario:
    rng = np.random.default_rng(seed)
    t = grid(3.0, 0.05)
    speed = 8.0 - 0.5 * t
    ego = Trajectory(
        t, 8 * t - 0.25 * t**2, 0.6 * t, 0.2 * np.sin(t), speed, -0.5 + 0 * t, 0.025 * np.cos(t)
    )
    kinds = (AgentKind.CAR, AgentKind.PEDESTRIAN, AgentKind.BICYCLE, AgentKind.TRUCK)
    agents = [
        (str(i), kind, CAR, moving(rng.uniform(-5, 40), rng.uniform(-6, 6), *rng.uniform(-6, 6, 2)))
        for i, kind in enumerate(kinds)
    ]
    return scenario(ego, agents)


@pytest.mark.parametrize("seed", range(3))
def test_where_a_drive_is_cut_changes_no_step_before(seed: int) -> None:
    """PET alone looks at what comes later: at the passage of the other."""
    whole = crowd(seed)
    part = replace(whole, ego=whole.ego.between(0.0, 2.0))
    one, two = (series(drive(log), log, metrics=MINE) for log in (whole, part))
    one = one[one["t_s"] <= 2.0 + 1e-9]
    for name in set(two["metric"]) - {"pet.ego_first", "pet.ego_second", "pet.crossing"}:
        a, b = (frame.loc[frame["metric"] == name, "value"].to_numpy() for frame in (one, two))
        assert a == pytest.approx(b, abs=1e-9, nan_ok=True), name
