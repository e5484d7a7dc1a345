from math import pi

import numpy as np
import pytest
from hypothesis import given, strategies as st

from replan.logs.states import TRAJECTORY_COLUMNS, Controls, Trajectory, wrap, wrapped

angles = st.floats(-1000.0, 1000.0)


def straight(n: int = 5, step: float = 0.1, **changes: object) -> Trajectory:
    t = step * np.arange(n)
    columns = {
        "t": t,
        "x": 3.0 * t,
        "y": 0 * t,
        "yaw": 0 * t,
        "v": 3.0 + 0 * t,
        "a": 0 * t,
        "kappa": 0 * t,
    }
    return Trajectory(**(columns | changes))


@given(angles)
def test_wrap_is_the_same_direction_within_pi(angle: float) -> None:
    out = wrap(angle)
    assert -pi - 1e-12 <= out <= pi + 1e-12
    assert np.isclose(np.cos(out), np.cos(angle), atol=1e-11)
    assert np.isclose(np.sin(out), np.sin(angle), atol=1e-11)


@given(st.lists(angles, min_size=1, max_size=9))
def test_wrap_of_arrays_is_wrap_of_each(values: list[float]) -> None:
    assert wrapped(np.array(values)).tolist() == [wrap(value) for value in values]


def test_wrap_keeps_nan_and_sends_pi_to_minus_pi() -> None:
    assert wrap(pi) == -pi
    assert np.isnan(wrapped(np.array([np.nan]))[0])


@given(st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=30), st.floats(-10.0, 10.0))
def test_yaw_is_continuous_however_it_was_wrapped(turns: list[float], start: float) -> None:
    true = start + np.cumsum(turns)
    drive = straight(len(true), yaw=wrapped(true))
    assert np.allclose(np.diff(drive.yaw), np.diff(true), atol=1e-9)


@given(st.floats(-1.0, 2.0), st.integers(2, 9))
def test_resampling_at_one_time_is_the_state_at_it(t: float, n: int) -> None:
    drive = straight(n, x=np.sin(np.arange(n)))
    inside = float(np.clip(t, drive.t[0], drive.t[-1]))
    state, other = drive.at(t), drive.resampled(np.array([inside])).state(0)
    assert [getattr(state, name) for name in TRAJECTORY_COLUMNS[1:]] == [
        getattr(other, name) for name in TRAJECTORY_COLUMNS[1:]
    ]


@given(st.integers(0, 4))
def test_samples_are_themselves(index: int) -> None:
    drive = straight(x=np.arange(5.0) ** 2)
    assert drive.at(float(drive.t[index])).x == drive.state(index).x == index**2


def test_ends_hold_and_between_cuts() -> None:
    drive = straight()
    assert drive.at(-1.0).x == drive.state(0).x
    assert drive.at(9.0).x == drive.state(-1).x
    assert drive.between(0.05, 0.35).t.tolist() == pytest.approx([0.1, 0.2, 0.3])
    with pytest.raises(ValueError, match="not empty"):
        drive.between(5.0, 6.0)


@pytest.mark.parametrize("name", TRAJECTORY_COLUMNS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_value_that_is_not_finite_is_refused(name: str, bad: float) -> None:
    values = np.array(getattr(straight(), name))
    values[2] = bad
    with pytest.raises(ValueError, match=f"{name} is not finite at index 2"):
        straight(**{name: values})


@pytest.mark.parametrize("t", [[0, 0.1, 0.1, 0.2, 0.3], [0, 0.1, 0.05, 0.2, 0.3]])
def test_time_must_increase(t: list[float]) -> None:
    with pytest.raises(ValueError, match=r"time does not increase after 0\.1 s"):
        straight(t=np.array(t))


def test_columns_must_agree_and_not_be_empty() -> None:
    with pytest.raises(ValueError, match="v has shape"):
        straight(v=np.zeros(4))
    with pytest.raises(ValueError, match="not empty"):
        straight(0)


def test_columns_are_private_and_read_only() -> None:
    x = np.zeros(5)
    drive = straight(x=x)
    x[0] = 9.0
    assert drive.x[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        drive.x[0] = 9.0
    controls = Controls(np.arange(2.0), *np.zeros((3, 2)))
    with pytest.raises(ValueError, match="read-only"):
        controls.brake[0] = 1.0
