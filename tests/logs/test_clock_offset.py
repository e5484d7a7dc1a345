"""Road users on another clock: shifted where it is certain, asked where not, else left alone."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from replan.core.errors import LogError
from replan.logs.clock_offset import on_one_clock
from replan.logs.readers.table import from_frames
from replan.logs.scenario import Scenario


def log(rate: float, begins: float, ends: float, seconds: float = 60.0) -> Scenario:
    """A drive of 10 Hz, and road users at a rate who begin and end so much after it, s."""
    t = np.arange(0.0, seconds, 0.1)
    ego = pd.DataFrame({"t": t, "x": 9.0 * t, "y": 0.0, "yaw": 0.0, "v": 9.0})
    seen = np.arange(begins, seconds + ends, 1.0 / rate)
    agents = pd.DataFrame({"t": seen, "id": "7", "x": 9.0 * seen + 30.0, "y": 3.5, "yaw": 0.0})
    return from_frames(ego, agents)


@given(st.sampled_from([0.5, 1.0, 2.0, 10.0]), st.floats(-1.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_rare_samples_are_no_other_clock(rate: float, steps: float) -> None:
    """The first and the last sample of a slow sensor lie an interval off the ego's, at most."""
    shift = steps / rate if rate < 5.0 else 0.5 * steps
    scenario = log(rate, shift, shift)
    assert on_one_clock(scenario, np.inf) is scenario


@pytest.mark.parametrize("rate", [2.0, 10.0, 25.0])
@pytest.mark.parametrize("ahead", [18.0, -18.0, 37.0, -37.0, 19.0, 3600.0, -28800.0, 20700.0])
def test_known_differences_of_clocks_are_mended(ahead: float, rate: float) -> None:
    mended = on_one_clock(log(rate, ahead, ahead), np.inf)
    np.testing.assert_allclose(mended.tracks.t, log(rate, 0.0, 0.0).tracks.t, atol=1e-6)
    assert f"shifted by {-ahead:g} s" in mended.notes[-1]


@pytest.mark.parametrize("ahead", [4.2, -6.0, 25.0])
def test_other_differences_are_asked_and_the_answer_is_followed(ahead: float) -> None:
    scenario = log(10.0, ahead, ahead)
    with pytest.raises(LogError, match="another clock") as refused:
        on_one_clock(scenario, np.inf)
    assert f"clock_ahead_s = {ahead:g}" in (refused.value.remedy or "")
    assert on_one_clock(scenario, ahead).tracks.t[0] == pytest.approx(0.0, abs=1e-9)
    assert on_one_clock(scenario, 0.0) is scenario


@pytest.mark.parametrize(("begins", "ends"), [(12.0, 0.0), (0.0, -20.0), (9.0, -9.0), (5.0, 2.0)])
def test_traffic_that_was_recorded_in_part_is_no_other_clock(begins: float, ends: float) -> None:
    scenario = log(10.0, begins, ends)
    assert on_one_clock(scenario, np.inf) is scenario
