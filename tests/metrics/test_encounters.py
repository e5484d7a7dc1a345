"""TTC at constant acceleration, closest encounters, post-encroachment time, TTC to the vulnerable,
severity.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import CAR, EGO, NOSE, Agent, along, car, drive, grid, moving, scenario, world
from hypothesis import given, settings, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance
from replan.logs.tracks import Tracks
from replan.metrics import GROUPS, evaluate, series
from replan.metrics.encounters import MovingBox, closest_encounter, time_to_contact_accelerated
from replan.metrics.severity import MASS_KG, delta_v

MINE = {metric.name: metric for metric in GROUPS["safety"]}
TAIL = EGO.rear_overhang


def walker(x: float, y: float, vy: float) -> Agent:
    return "p", AgentKind.PEDESTRIAN, (0.6, 0.6), moving(x, y, 0.0, vy, 0.0)


def judged(log: Scenario) -> pd.DataFrame:
    return evaluate(drive(log), log, metrics=MINE).set_index("metric")


def first(log: Scenario, name: str) -> float:
    frames = series(drive(log), log, metrics=MINE)
    return float(frames.loc[frames["metric"] == name, "value"].iloc[0])


@settings(max_examples=60)
@given(st.integers(0, 10_000))
def test_accelerated_contact_is_the_first_touch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y, yaw = rng.uniform(-30, 30), rng.uniform(-30, 30), rng.uniform(-3, 3)
    (v, u), (a, b) = rng.uniform(1, 12, 2), rng.uniform(-3, 3, 2)
    found = time_to_contact_accelerated(
        MovingBox(0.0, 0.0, 0.0, 4.0, 2.0, v, 0.0, a),
        MovingBox(x, y, yaw, 4.0, 2.0, u * np.cos(yaw), u * np.sin(yaw), b),
        10.0,
    )

    def way(speed: float, rate: float, t: np.ndarray) -> np.ndarray:
        t = np.minimum(t, -speed / rate) if rate < 0.0 else t
        return speed * t + 0.5 * rate * t**2

    t = np.arange(0.0, 10.0, 0.01)
    d, e = way(v, a, t), way(u, b, t)
    apart = np.array(
        [
            distance(
                d[k],
                0.0,
                0.0,
                4.0,
                2.0,
                x + e[k] * np.cos(yaw),
                y + e[k] * np.sin(yaw),
                yaw,
                4.0,
                2.0,
            )
            for k in range(len(t))
        ]
    )
    early = t < min(found, 10.0) - 0.01
    assert (apart[early] > 0.0).all() or apart[early].min() > -1e-9
    if found < 9.98:
        assert apart[np.searchsorted(t, found)] < 0.15


def test_accelerated_time_to_contact_sees_the_braking_lead() -> None:
    """At t = 0.5 s of a lead at 10 m/s that brakes with 3 m/s2 from 0 on, 30 m ahead of 15 m/s: at
    8.5 m/s and 30 + 4.625 - 7.5 = 27.125 m: 6.5 t + 1.5 t^2 = 27.125: t = 2.606; at constant speed
    4.17 s."""
    braking = (
        "7",
        AgentKind.CAR,
        CAR,
        lambda t: (30.0 + NOSE + 2.25 + 10.0 * t - 1.5 * t**2, 0 * t, 0 * t),
    )
    frames = series(drive(log := world(15.0, braking, seconds=1.0)), log, metrics=MINE)
    row = frames[np.isclose(frames["t_s"], 0.5)].set_index("metric")["value"]
    assert row["ttc_accelerated"] == pytest.approx(
        (np.sqrt(6.5**2 + 6.0 * 27.125) - 6.5) / 3.0, abs=0.02
    )
    assert row["ttc"] == pytest.approx(27.125 / 6.5, abs=0.02)


@settings(max_examples=60)
@given(st.integers(0, 10_000))
def test_the_closest_encounter_is_the_least_of_all_times(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one = (0.0, 0.0, rng.uniform(-3, 3), 4.0, 2.0)
    x, y, yaw = rng.uniform(-20, 20), rng.uniform(-20, 20), rng.uniform(-3, 3)
    v, u = rng.uniform(-8, 8, 2), rng.uniform(-8, 8, 2)
    near, when = closest_encounter(
        MovingBox(*one, *v, 0.0), MovingBox(x, y, yaw, 5.0, 1.5, *u, 0.0), 10.0
    )
    t = np.linspace(0.0, 10.0, 1001)
    apart = [distance(*one, x + (u[0] - v[0]) * s, y + (u[1] - v[1]) * s, yaw, 5.0, 1.5) for s in t]
    assert near <= min(apart) + 1e-9
    assert near == pytest.approx(min(apart), abs=0.1)
    then = distance(*one, x + (u[0] - v[0]) * when, y + (u[1] - v[1]) * when, yaw, 5.0, 1.5)
    assert then == pytest.approx(near, abs=1e-6)


@pytest.mark.parametrize(
    ("start", "part", "word"), [(-14.0, "ego_first", "second"), (1.8, "ego_second", "first")]
)
def test_post_encroachment_time_at_a_crossing(start: float, part: str, word: str) -> None:
    """A box 2 x 2 m crosses at x = 20, 2 m/s upwards: it is in the ego's band while |y| < 0.805 + 1
    = 1.805 m. From y = -14 it takes the band at 6.0975 s; the ego, 10 m/s, has its tail past x = 21
    at (21 + 0.9) / 10 = 2.19 s: 3.91. From y = 1.8 it is out at 0.0025 s; the ego's nose is at x =
    19 at (19 - 3.608) / 10 = 1.54 s."""
    box = ("7", AgentKind.CAR, (2.0, 2.0), moving(20.0, start, 0.0, 2.0))
    table = judged(world(10.0, box, seconds=8.0))
    expected = {"ego_first": (14.0 - 1.805) / 2.0 - 2.19, "ego_second": 1.5392}[part]
    assert table.loc[f"pet.{part}.min", "value"] == pytest.approx(expected, abs=0.2)
    assert table.loc["pet.crossing.min", "value"] == table.loc[f"pet.{part}.min", "value"]
    assert table.loc["pet.crossing.min", "reason"] == f"car 7 {word}"
    other = {"ego_first": "ego_second", "ego_second": "ego_first"}[part]
    assert not table.loc[f"pet.{other}.min", "available"]


def test_a_pedestrian_crosses_with_any_heading_of_the_box() -> None:
    """0.6 m, 1 m/s from y = -3, in the band (0.805 + 0.3) from 1.895 s on.

    The tail is past 10.3 m after 1.12 s.
    """
    found = judged(world(10.0, walker(10.0, -3.0, 1.0))).loc["pet.crossing.min"]
    assert found["value"] == pytest.approx(1.895 - 1.12, abs=0.2)
    assert found["reason"] == "pedestrian p second"


def test_a_follower_has_a_post_encroachment_time_and_does_not_cross() -> None:
    """A lead 20 m ahead at the same 10 m/s leaves each place 2 s before the ego is there."""
    table = judged(world(10.0, car(NOSE + 22.25, 0.0, 10.0)))
    assert table.loc["pet.ego_second.min", "value"] == pytest.approx(2.0, abs=0.11)
    assert table.loc["pet.crossing.min", "reason"] == "no other crossed the ego's way"
    parked = world(10.0, car(20.0, 4.0, 0.0, yaw=0.0))
    assert not judged(parked).loc["pet.ego_second.min", "available"]


def test_the_vulnerable_have_a_time_to_collision_of_their_own() -> None:
    """The car ahead is nearer in time: (20 - 0) / 10 = 2 s.

    The pedestrian in front of it: (30 - 0.3) / 10 = 2.97 s.
    """
    log = world(
        10.0, car(NOSE + 22.25, 0.0, 0.0, yaw=0.0), walker(NOSE + 30.0, -0.5, 0.1), seconds=0.1
    )
    assert first(log, "ttc") == pytest.approx(2.0)
    assert first(log, "ttc_vulnerable") == pytest.approx(2.97)
    assert not judged(world(10.0, car(30.0, 0.0, 0.0, yaw=0.0))).loc[
        "ttc_vulnerable.min", "available"
    ]


def test_at_a_collision_at_fault_ttc_is_zero_and_its_time_counts() -> None:
    """In reverse, 3 m/s, into a car that stands 2 m behind: those behind have no TTC, but the touch
    after 0.667 s is the ego's fault. The drive ends with it: the last step stands for half of its
    0.01 s."""
    log = scenario(along(grid(0.67), -3.0), [car(-TAIL - 2.25 - 2.0, 0.0, 0.0, yaw=0.0)])
    table = judged(log)
    assert table.loc["collision_at_fault.count", "value"] == 1
    assert (table.loc["ttc.min", "value"], table.loc["ttc.min", "reason"]) == (0.0, "car 7")
    assert table.loc["ttc.time_below_950ms", "value"] == pytest.approx(0.005)
    assert table.loc["ttc.integrated_1500ms", "value"] == pytest.approx(0.0075)


def test_time_exposed_and_time_integrated() -> None:
    """Standing car, 10 m/s, the drive ends 0.5 s before the touch: TTC from 1.5 to 0.5 s: 1 s
    exposed, and the integral of 1.5 - TTC is 1 / 2 s^2."""
    table = judged(world(10.0, car(NOSE + 2.25 + 35.0, 0.0, 0.0, yaw=0.0), seconds=3.0))
    assert table.loc["ttc.time_below_1500ms", "value"] == pytest.approx(1.0, abs=0.011)
    assert table.loc["ttc.integrated_1500ms", "value"] == pytest.approx(0.5, abs=0.011)


def test_the_severity_of_a_collision() -> None:
    """10 into 2 m/s from behind: 8 m/s.

    The ego's delta-v 8 * 1500 / (1500 + 1093.3) = 4.627 m/s.
    """
    log = world(10.0, car(20.0, 0.0, 2.0))
    table = judged(log)
    row = table.loc["collision_severity.impact_speed.max"]
    assert row["value"] == pytest.approx(8.0)
    assert table.loc["collision_severity.delta_v.max", "value"] == pytest.approx(
        8.0 * 1500.0 / 2593.3
    )
    assert row["reason"] == "car 7: with the front, at fault"
    assert row["time_s"] == table.loc["collision.count", "time_s"]
    assert (
        table.loc["collision_at_fault.count", "reason"]
        == "car 7: with the front, at fault, 8.0 m/s"
    )


def test_masses_and_their_limits() -> None:
    assert set(MASS_KG) == set(AgentKind)
    assert delta_v(10.0, 1000.0, 1000.0) == 5.0
    assert delta_v(10.0, 1000.0, MASS_KG[AgentKind.OBJECT]) == 10.0


def test_no_severity_without_an_impact() -> None:
    log = world(10.0, car(1.0, 0.5, 10.0))
    table = judged(log)
    assert table.loc["collision.count", "value"] == 1
    assert table.loc["collision_severity.delta_v.max", "reason"] == "no collision"
    empty = replace(log, tracks=Tracks.empty())
    assert not judged(empty).loc["collision_severity.delta_v.max", "available"]
