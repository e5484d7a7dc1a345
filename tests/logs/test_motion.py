"""The estimated motion of the others: laws of noise, rate and frame, and what happens at abrupt
changes.
"""

from dataclasses import replace
from math import cos, sin

import numpy as np
import pytest
from handmade import drive, scenario, straight, track, tracks
from hypothesis import given, settings, strategies as st

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.trace import EndReason, Mode, Trace
from replan.logs.tracks import Tracks
from replan.metrics.boxes import others_at
from replan.metrics.time_to_collision import ttc as ttc_metric

RATES = (5.0, 10.0, 25.0, 50.0, 100.0)
EGO = drive(straight, 12.0, 6.0, step=0.05)
CAR = scenario(EGO).vehicle


def times(rate: float, duration: float = 6.0) -> FloatArray:
    return np.round(np.arange(0.0, duration + 1e-9, 1.0 / rate), 9)


def noisy(made: Tracks, sigma: float, seed: int) -> Tracks:
    rng = np.random.default_rng(seed)
    return replace(
        made, **{c: getattr(made, c) + sigma * rng.standard_normal(len(made.t)) for c in "xy"}
    )


def braking(
    t: FloatArray, v: float, at: float, decel: float, until: float = 0.0
) -> tuple[FloatArray, ...]:
    """Position, speed and acceleration of who brakes from `at` on, to the speed `until`."""
    lasts = (v - until) / decel
    u = np.clip(t - at, 0.0, lasts)
    x = v * np.minimum(t, at) + v * u - 0.5 * decel * u**2 + until * np.maximum(t - at - lasts, 0.0)
    return x, v - decel * u, np.where((t > at) & (t < at + lasts), -decel, 0.0)


def ttc(others: Tracks) -> FloatArray:
    made = scenario(EGO, agents=others)
    trace = Trace(
        made.name, "p", Mode.CLOSED, False, made.ego, made.tracks, (), EndReason.END_OF_LOG
    )
    return ttc_metric.measure(trace, made).value


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("closing", [0.0, 2.0, 5.0, 8.0])
def test_noise_of_5_cm_changes_ttc_by_less_than_a_tenth_at_any_rate(
    rate: float, closing: float
) -> None:
    """20 m behind a lead, down to a gap of 5 m, below which the positions' own noise is seen."""
    t = times(rate)
    gap = 20.0 - closing * t
    lead = track("lead", t, CAR.axle_to_front + 12.0 * t + gap + 2.25, np.zeros(len(t)))
    clean = ttc(tracks(lead))
    for seed in range(3):
        found = ttc(noisy(tracks(lead), 0.05, seed))
        if closing == 0.0:
            assert np.isnan(found).all()
            continue
        near = (20.0 - closing * EGO.t > 5.0) & (clean < 9.0)
        assert near.sum() > 20
        assert found[near] == pytest.approx(clean[near], rel=0.1)


@given(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0), st.sampled_from(RATES), st.booleans())
def test_uniform_motion_is_exact(vx: float, vy: float, rate: float, logged: bool) -> None:
    t = times(rate, 3.0)
    velocity = {"vx": vx, "vy": vy} if logged else {}
    found = tracks(track("a", t, 5.0 + vx * t, vy * t - 3.0, **velocity)).motion
    assert found.vx == pytest.approx(vx, abs=1e-6) and found.vy == pytest.approx(vy, abs=1e-6)
    assert np.abs([found.ax, found.ay]).max() < 1e-5


@pytest.mark.parametrize(
    ("sigma", "far", "near"), [(0.0, 0.01, 0.15), (0.02, 0.4, 0.5), (0.05, 0.6, 0.75)]
)
@pytest.mark.parametrize("rate", RATES)
def test_a_hard_brake_is_smeared_over_less_than_a_second(
    rate: float, sigma: float, far: float, near: float
) -> None:
    """8 m/s2 for 1.5 s: the speed's error within a second of either change, and beyond; m/s."""
    t = times(rate, 12.0)
    x, v, _ = braking(t, 15.0, 6.03, 8.0, until=3.0)
    found = noisy(tracks(track("a", t, x, np.zeros(len(t)))), sigma, 1).motion
    off = np.hypot(found.vx - v, found.vy)
    beside = (np.abs(t - 6.03) < 1.0) | (np.abs(t - 7.53) < 1.0)
    assert off[beside].max() < near
    assert off[~beside].max() < far


@pytest.mark.parametrize(("sigma", "error"), [(0.0, 0.2), (0.05, 1.2)])
@pytest.mark.parametrize("logged", [False, True])
@pytest.mark.parametrize("rate", [10.0, 50.0])
def test_the_deceleration_of_a_braking_lead_is_estimated(
    rate: float, sigma: float, error: float, logged: bool
) -> None:
    """5 m/s2 for 3 s, half a second away from its begin and end."""
    t = times(rate, 12.0)
    x, v, a = braking(t, 20.0, 4.0, 5.0, until=5.0)
    noise = 0.1 * (sigma > 0.0) * np.random.default_rng(2).standard_normal((2, len(t)))
    velocity = {"vx": v + noise[0], "vy": noise[1]} if logged else {}
    made = noisy(tracks(track("a", t, x, np.zeros(len(t)), **velocity)), sigma, 3)
    inside = (t > 4.5) & (t < 6.5)
    assert made.motion.accel[inside] == pytest.approx(a[inside], abs=error)
    others = others_at(made, t)
    assert others.accel[0] == pytest.approx(made.motion.accel)
    assert others.pose[3, 0] == pytest.approx(made.motion.vx)


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("sigma", "error"), [(0.0, 0.01), (0.05, 0.12)])
def test_the_yaw_rate_on_a_circle_is_estimated(
    rate: float, side: float, sigma: float, error: float
) -> None:
    """8 m/s on 20 m: 0.4 rad/s, half a second away from the track's ends.

    One that stands in noise hardly turns.
    """
    t = times(rate, 6.0)
    x, y = 20.0 * np.sin(0.4 * t), side * 20.0 * (1.0 - np.cos(0.4 * t))
    inside = (t > 0.5) & (t < 5.5)
    made = noisy(tracks(track("a", t, x, y)), sigma, 1)
    assert made.motion.turn[inside] == pytest.approx(side * 0.4, abs=error)
    assert others_at(made, t).turn[0] == pytest.approx(made.motion.turn)
    assert np.abs(noisy(tracks(track("a", t, 0.0 * t, 0.0 * t)), sigma, 1).motion.turn).max() < 0.1


@pytest.mark.parametrize(
    ("kind", "v", "decel"),
    [(AgentKind.CAR, 10.0, 6.0), (AgentKind.PEDESTRIAN, 1.5, 3.75), (AgentKind.BICYCLE, 4.0, 3.0)],
)
@pytest.mark.parametrize("sigma", [0.0, 0.05])
def test_a_stopped_vehicle_has_no_velocity(
    kind: AgentKind, v: float, decel: float, sigma: float
) -> None:
    t = times(10.0, 12.0)
    x, _, _ = braking(t, v, 4.0, decel)
    found = noisy(tracks(track("a", t, x, np.zeros(len(t)), kind=kind)), sigma, 4).motion
    stands = t > 5.0 + v / decel
    assert np.hypot(found.vx, found.vy)[stands].max() < (0.01 if sigma == 0.0 else 0.35)
    assert np.hypot(found.vx, found.vy)[stands].mean() < (0.001 if sigma == 0.0 else 0.15)


def test_logged_velocities_are_believed_where_positions_are_noisy_or_disagree() -> None:
    t = times(10.0)
    made = tracks(track("a", t, 7.0 * t, np.zeros(len(t)), vx=5.0, vy=1.0))
    for found in (made.motion, noisy(made, 0.5, 1).motion):
        assert found.vx == pytest.approx(5.0, abs=1e-6) and found.vy == pytest.approx(1.0, abs=1e-6)


def wavy(seed: int) -> Tracks:
    """Two cars that steer and brake, one with velocities, and a pedestrian; 2 cm of noise."""
    t = times(10.0, 5.0)
    velocity = {"vx": 8.0 - np.cos(t), "vy": -np.sin(t)}
    some = [
        track(name, t, 8.0 * t - np.sin(t), np.cos(t) + i, kind=kind, **(velocity if i else {}))
        for i, (name, kind) in enumerate(
            (("a", AgentKind.CAR), ("b", AgentKind.CAR), ("c", AgentKind.PEDESTRIAN))
        )
    ]
    return noisy(tracks(*some), 0.02, seed)


def velocities(made: Tracks) -> FloatArray:
    found = made.motion
    return np.stack([found.vx, found.vy, found.ax, found.ay])


@settings(max_examples=25)
@given(
    st.integers(0, 99),
    st.floats(-3.2, 3.2),
    st.floats(-1e4, 1e4),
    st.floats(-1e3, 1e3),
    st.sampled_from([-1.0, 1.0]),
)
def test_moved_mirrored_and_later_alike(
    seed: int, angle: float, offset: float, later: float, mirror: float
) -> None:
    made = wavy(seed)
    turn = np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]]) @ np.diag([1.0, mirror])
    (x, y), (vx, vy) = turn @ np.stack([made.x, made.y]), turn @ np.stack([made.vx, made.vy])
    other = replace(made, t=made.t + later, x=x + offset, y=y - offset, vx=vx, vy=vy)
    before, after = velocities(made), velocities(other)
    assert after[:2] == pytest.approx(turn @ before[:2], abs=1e-5)
    assert after[2:] == pytest.approx(turn @ before[2:], abs=1e-4)


@given(st.integers(0, 99))
def test_the_order_of_tracks_does_not_matter_and_the_bits_are_the_same(seed: int) -> None:
    made = wavy(seed)
    columns = {
        c: getattr(made, c).reshape(3, -1)[::-1].ravel() for c in ("t", "x", "y", "yaw", "vx", "vy")
    }
    turned = replace(made, ids=made.ids[::-1], kinds=made.kinds[::-1], **columns)
    there = velocities(turned).reshape(4, 3, -1)[:, ::-1].reshape(4, -1)
    assert (
        np.ascontiguousarray(there).tobytes()
        == velocities(made).tobytes()
        == velocities(replace(made)).tobytes()
    )
