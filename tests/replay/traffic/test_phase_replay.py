"""What a replay keeps of the tracks that it plays."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from handmade import track, tracks

from replay.traffic.phase_replay import PERIOD_S, PhaseReplay


def test_who_is_not_as_in_the_log_is_as_played_from_the_sample_before() -> None:
    """By hand: two cars, played half a period late; the second is late from 0.1 s on, known at 0.2 s."""
    t = PERIOD_S * np.arange(4)
    log = tracks(track("1", t, np.arange(4.0), 0.0 * t), track("2", t, np.arange(4.0, 8.0), 0.0 * t))
    replay, both = PhaseReplay(log), np.arange(2)
    for k in range(4):
        replay.add(k * PERIOD_S, both, np.full(2, max((k - 0.5) * PERIOD_S, 0.0)), np.ones(2))
        seen = replay.tracks(np.array([np.inf, np.inf if k < 2 else PERIOD_S]))
        assert (seen is log) == (k < 2)
    np.testing.assert_allclose(seen.t, np.r_[t, t], atol=1e-12)
    np.testing.assert_allclose(seen.x, [0.0, 1.0, 2.0, 3.0, 4.0, 4.5, 5.5, 6.5], atol=1e-9)


@pytest.mark.slow
def test_memory_is_that_of_who_is_late_and_not_of_all_at_all_times() -> None:
    """100 cars over 600 samples are 2.4 MB of poses; with one late car less than 0.3 MB are held."""
    t = np.arange(0.0, 60.5, 0.5)
    log = tracks(*(track(str(i), t, t, np.full(121, 10.0 * i)) for i in range(100)))
    replay, since, everybody = PhaseReplay(log), np.r_[1.0, np.full(99, np.inf)], np.arange(100)
    rows = [PERIOD_S * k for k in range(600)]
    replay.add(rows[0], everybody, np.zeros(100), np.ones(100))
    replay.tracks(since)
    tracemalloc.start()
    for now in rows[1:]:
        replay.add(now, everybody, np.full(100, now), np.ones(100))
        seen = replay.tracks(since)
    sizes = np.diff(seen.whole.offsets).tolist()
    del seen
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert sizes == [2 + 590, *[121] * 99]
    assert held < 300_000
