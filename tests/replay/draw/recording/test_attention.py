"""Who is drawn in full, and axes with two numbers: laws."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from replay.draw.model import NEAR_M, NEAREST, in_full
from replay.draw.recording.plots import MOST_NUMBERS, with_two_numbers

places = st.lists(st.tuples(st.floats(-200.0, 200.0), st.floats(-200.0, 200.0)), max_size=40)


@given(places, st.sets(st.integers(0, 39)))
def test_the_decided_and_the_nearest_are_drawn_in_full(where: list[tuple[float, float]], about: set[int]) -> None:
    xy, ids = np.array(where).reshape(-1, 2), [f"a{i}" for i in range(len(where))]
    full = in_full(ids, xy[:, 0], xy[:, 1], {f"a{i}" for i in about}, (0.0, 0.0)).tolist()
    assert full == sorted(set(full))
    if len(ids) <= NEAREST:
        assert full == list(range(len(ids)))
        return
    assert {i for i in about if i < len(ids)} <= set(full)
    others = set(full) - about
    assert len(others) <= NEAREST
    away = np.hypot(xy[:, 0], xy[:, 1])
    assert all(away[i] <= NEAR_M for i in others)
    left = set(range(len(ids))) - set(full)
    assert all(away[j] > NEAR_M or away[j] >= np.sort(away)[NEAREST - 1] for j in left)


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3))
def test_an_axis_holds_two_numbers_and_is_not_much_longer(low: float, span: float) -> None:
    bottom, top = with_two_numbers(low, low + span)
    step = 10.0 ** np.ceil(np.log10(span / MOST_NUMBERS) - 1e-9)
    assert np.floor(top / step + 1e-6) - np.ceil(bottom / step - 1e-6) >= 1.0
    assert bottom <= low + 1e-9 * abs(low) and top >= low + span - 1e-9 * abs(low)
    assert top - bottom <= max(span, 0.0) + 1.2 * step
