"""Walking over a drive in pieces, or agent by agent, measures what is measured at once; and memory does not grow."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import metrics
from logs.catalogue import scenario
from metrics import others
from metrics.others import each, others_at, pieces
from replay.loop.closed_loop import run_closed_loop
from replay.loop.open_loop import run_open_loop

LOGS = ("everyday/junction", "everyday/crosswalk", "pedestrian/group", "everyday/cyclist")
SIZES = ((40, 7), (1, 1), (900, 250))
CASES = [
    pytest.param(name, *size, marks=[pytest.mark.slow] * (i != k or i > 1))
    for i, name in enumerate(LOGS)
    for k, size in enumerate(SIZES)
]


@pytest.mark.parametrize(("name", "cells", "steps"), CASES)
def test_the_size_of_the_pieces_changes_no_bit(
    monkeypatch: pytest.MonkeyPatch, name: str, cells: int, steps: int
) -> None:
    world = scenario(name)
    drives = [loop(world, "constant_speed").trace for loop in (run_open_loop, run_closed_loop)]
    whole = [metrics.evaluate_with_series(trace, world) for trace in drives]
    monkeypatch.setattr(others, "MOST_CELLS", cells)
    monkeypatch.setattr(others, "PIECE_STEPS", steps)
    monkeypatch.setattr("metrics.proposals.PIECE", steps)
    for trace, (table, series) in zip(drives, whole, strict=True):
        again = scenario(name)  # the caches of the first know what was measured at once
        table_again, series_again = metrics.evaluate_with_series(trace, again)
        pd.testing.assert_frame_equal(table, table_again, check_exact=True)
        pd.testing.assert_frame_equal(series, series_again, check_exact=True)


def test_a_piece_holds_those_who_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    tracks, t = scenario("everyday/junction").tracks, np.arange(0.0, 30.0, 0.1)
    whole = others_at(tracks, t)
    monkeypatch.setattr(others, "MOST_CELLS", 100)
    seen = np.zeros_like(whole.there)
    for steps, agents, some in pieces(tracks, t):
        assert some.there.size <= 100 and some.there.shape == (len(agents), steps.stop - steps.start)
        np.testing.assert_array_equal(some.pose, whole.pose[:, agents, steps])
        seen[agents, steps] = some.there
    np.testing.assert_array_equal(seen, whole.there)
    for i, some, row in each(tracks, t):
        np.testing.assert_array_equal(some.accel[row], whole.accel[i])
