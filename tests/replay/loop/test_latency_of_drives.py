"""Planning takes time: a plan is driven from `plan_delay_s` after its frame on."""

from __future__ import annotations

import numpy as np
import pytest
from handmade import drive, s_curve, scenario
from hypothesis import given
from hypothesis import strategies as st

from logs import ConfigError, Plan
from replay.config import LoopConfig
from replay.loop.closed_loop import run_closed_loop
from replay.loop.latency import Latency

LINE = drive(s_curve, 10.0, 1.0)


@given(st.integers(0, 40), st.integers(1, 12))
def test_the_plan_driven_is_the_last_that_is_old_enough(delay: int, every: int) -> None:
    latency, made = Latency(delay), {}
    for step in range(80):
        if step % every == 0:
            latency.before(step)
            made[step] = Plan(LINE)
            latency.planned(step, made[step])
        due = [k for k in made if k + delay <= step]
        assert latency.at(step) is made[max(due) if due else 0]


def test_without_delay_nothing_changes_and_with_it_the_drive_says_so() -> None:
    log = scenario(drive(s_curve, 12.0, 6.0))
    now, late = (
        run_closed_loop(log, "logged", config=LoopConfig(plan_delay_s=seconds)).trace for seconds in (0.0, 0.15)
    )
    plain = run_closed_loop(log, "logged").trace
    np.testing.assert_array_equal(plain.ego.y, now.ego.y)
    assert not any("after its frame" in note for note in now.notes)
    assert "each plan but the first is driven from 0.15 s after its frame on" in late.notes
    assert len(late.frames) == len(now.frames)
    assert np.abs(late.tracking.lateral).max() < 0.02  # plans carry their times: late is not wrong


def test_a_delay_must_fit_the_control_period() -> None:
    with pytest.raises(ConfigError, match="plan_delay_s"):
        LoopConfig(plan_delay_s=0.005)
    with pytest.raises(ConfigError, match="not be negative"):
        LoopConfig(plan_delay_s=-0.1)
