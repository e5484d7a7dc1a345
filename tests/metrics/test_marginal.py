"""Which values are too near to their bounds for the rate of the log."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from drives import along, drive, grid, moving, scenario
from hypothesis import given
from hypothesis import strategies as st

from logs import AgentKind
from logs.transform import sampled
from metrics import METRICS, evaluate
from metrics.judge.excuses import INTERVAL, marginal
from metrics.judge.gates import Gate, load_gates


def of(values: Mapping[str, float]) -> Callable[[str], float]:
    return lambda name: values.get(name, float("nan"))


TTC = Gate("ttc.time_below_950ms", max=0.0)


@pytest.mark.parametrize(("rate", "near"), [(5.0, 0.3), (10.0, 0.15), (20.0, 0.075)])
@given(st.floats(0.05, 3.0))
def test_a_time_is_marginal_within_one_and_a_half_intervals(rate: float, near: float, least: float) -> None:
    values = {"ttc.min": least, "ttc.time_below_950ms": float(least < 0.95), INTERVAL: 1.0 / rate}
    said = marginal(TTC, of(values))
    if abs(abs(least - 0.95) - near) > 1e-6:
        assert bool(said) == (abs(least - 0.95) < near)
    assert not said or said.startswith(f"marginal: at {rate:g} Hz the bound of 0.95 s is within {near:.2g} s of ")


def test_a_flip_by_the_rate_is_marked() -> None:
    """0.79 s at 20 Hz is 1.05 s at 5 Hz: the outcome at 5 Hz is marginal."""
    assert "of 1.05 s" in marginal(TTC, of({"ttc.min": 1.05, "ttc.time_below_950ms": 0.0, INTERVAL: 0.2}))
    assert not marginal(TTC, of({"ttc.min": 1.05, "ttc.time_below_950ms": 0.0}))
    assert not marginal(TTC, of({INTERVAL: 0.2}))


def test_what_is_not_about_others_or_far_from_its_bound_is_not_marginal() -> None:
    values = {"off_road.max": 0.3, "off_road.time_beyond_30cm": 0.0, "lat_accel.worst_episode": 0.0, INTERVAL: 0.2}
    values |= {"yielding.recorded.min": 1.4, "yielding.recorded.below_1500ms": 2.0}
    values |= {"thw.time_below_900ms": 4.8, "gap_kept.min": 0.5, "gap_kept.time_below_20cm": 0.0}
    found = {gate.metric for gate in load_gates(None).gates if marginal(gate, of(values))}
    assert found == {"thw.time_below_900ms", "gap_kept.time_below_20cm", "yielding.recorded.below_1500ms"}
    assert marginal(Gate("gap_kept.min", min=0.5), of(values | {"gap_kept.min": 0.7})).endswith("0.36 m of 0.7 m")
    assert not marginal(Gate("lon_accel.max_abs", max=4.0), of({"lon_accel.max_abs": 4.0, INTERVAL: 0.2}))


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
def test_the_time_to_collision_of_one_drive_does_not_hang_on_the_rate(rate: float) -> None:
    """A pedestrian walks in, and a car ahead brakes: the same drive among agents at another rate, within (2)."""
    t = grid(6.0, 0.05)
    walker = ("p", AgentKind.PEDESTRIAN, (0.6, 0.6), moving(45.0, -6.0, 0.0, 1.5))
    lead = ("c", AgentKind.CAR, (4.5, 1.8), lambda t: (25.0 + 10.0 * t - 0.8 * t**2, 3.5 + 0 * t, 0 * t))
    log = scenario(along(t, 10.0), [walker, lead])
    asked = {name: METRICS[name] for name in ("ttc", "gap_kept", "agent_interval")}
    fine, coarse = (
        evaluate(drive(log, log.ego) if tracks is log else drive(tracks, log.ego), tracks, metrics=asked).set_index(
            "metric"
        )["value"]
        for tracks in (log, sampled(log, rate))
    )
    assert coarse[INTERVAL] == pytest.approx(1.0 / rate)
    assert coarse["ttc.min"] == pytest.approx(fine["ttc.min"], abs=0.05)
    assert coarse["gap_kept.min"] == pytest.approx(fine["gap_kept.min"], abs=0.05)
    assert np.isfinite(fine["ttc.min"])
