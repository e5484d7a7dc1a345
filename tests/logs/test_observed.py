"""When a log's traffic was observed: laws of streams and of inference, then examples, writing and
cutting.
"""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from commonroad_files import driving, problem, straight, vehicle, written
from handmade import drive, scenario, straight as straight_on, track, tracks
from hypothesis import given, strategies as st

from replan.logs.catalogue import scenario as built_in
from replan.logs.observed import described, of_stream, within
from replan.logs.readers.commonroad import read_commonroad
from replan.logs.scenario import Scenario
from replan.logs.tracks import Tracks

LOG = drive(straight_on, 10.0, 12.0)


def present(*spans: tuple[float, float], step: float = 0.1) -> Tracks:
    """A road user for each span of time, driving side by side."""
    made = []
    for i, (first, last) in enumerate(spans):
        t = np.round(np.arange(first, last + 1e-9, step), 9)
        made.append(track(f"a{i}", t, 10.0 * t, np.full(len(t), 4.0 * i)))
    return tracks(*made)


def spans_of(
    *spans: tuple[float, float], duration: float = 12.0
) -> tuple[tuple[float, float], ...]:
    return scenario(LOG, agents=present(*spans), duration=duration).traffic_spans


@given(st.lists(st.integers(0, 200), min_size=1, max_size=60, unique=True))
def test_a_stream_was_observed_at_each_of_its_messages_and_not_beyond_them(
    ticks: list[int],
) -> None:
    t = 0.1 * np.array(ticks)
    spans = of_stream(t)
    assert within(spans, t).all()
    assert not within(spans, np.array([t.min() - 0.01, t.max() + 0.01])).any()
    assert all(before[1] < after[0] for before, after in pairwise(spans))


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(1, 50)), min_size=1, max_size=12))
def test_the_inferred_span_begins_with_the_first_and_ends_with_one_of_them(
    rows: list[tuple[int, int]],
) -> None:
    given_spans = [(0.1 * a, round(0.1 * (a + n), 9)) for a, n in rows]
    ((first, last),) = spans_of(*given_spans)
    assert first == pytest.approx(min(span[0] for span in given_spans))
    assert any(abs(last - span[1]) < 1e-6 for span in given_spans)
    assert last >= max(span[0] for span in given_spans) - 1e-9  # nobody begins later
    assert spans_of(*given_spans[::-1]) == ((first, last),)  # in any order of agents


def test_a_straggler_does_not_extend_a_span_in_which_nine_vanish_together() -> None:
    assert spans_of(*[(0.0, 3.0)] * 9, (0.0, 9.0)) == ((0.0, 3.0),)


def test_tracks_that_end_one_by_one_do_not_end_the_recording() -> None:
    assert spans_of(*((0.0, 1.0 + i) for i in range(9))) == ((0.0, 9.0),)
    # Two who leave together are no end
    assert spans_of((0.0, 3.0), (0.0, 3.0), (0.0, 9.0)) == ((0.0, 9.0),)
    assert spans_of(*[(0.0, 3.0)] * 9, (4.0, 9.0)) == ((0.0, 9.0),)  # somebody appears later


def test_traffic_on_another_clock_was_observed_at_no_time() -> None:
    log = scenario(LOG, agents=present((0.0, 12.0)).shifted(1e6), duration=12.0)
    assert log.traffic_spans == () and described(log.traffic_spans) == "at no time"


@pytest.mark.parametrize(("tags", "spans"), [(("recorded",), ()), (("synthetic",), ((0.0, 12.0),))])
def test_a_recorded_log_without_road_users_says_nothing_of_traffic(
    tags: tuple[str, ...], spans: object
) -> None:
    assert replace(scenario(LOG), tags=tags).traffic_spans == spans


def test_the_catalogue_states_that_its_world_is_whole() -> None:
    log = built_in("paper/free_road")
    assert log.traffic == ((0.0, log.duration),)


def commonroad(folder: Path, *vehicles: str) -> Scenario:
    return read_commonroad(
        written(folder, straight(1), straight(2, y=4.0), *vehicles, problem(9, 0.0, 0.0, 10.0))
    )


SHORT = [vehicle(20 + i, driving(20.0 * i, 4.0, 10.0, steps=2)) for i in range(4)]
ENDS_AT_ONCE = ((0.0, pytest.approx(0.1)),)


def test_commonroad_traffic_that_ends_at_once_was_observed_until_then(tmp_path: Path) -> None:
    assert commonroad(tmp_path, *SHORT).traffic == ENDS_AT_ONCE


def test_a_straggler_does_not_extend_the_span_of_commonroad_traffic(tmp_path: Path) -> None:
    straggler = vehicle(30, driving(90.0, 4.0, 1.0, steps=31))
    assert commonroad(tmp_path, *SHORT, straggler).traffic == ENDS_AT_ONCE


def test_a_commonroad_file_without_traffic_says_that_there_was_none(tmp_path: Path) -> None:
    empty = commonroad(tmp_path)
    assert empty.traffic == ((0.0, empty.duration),)
