"""Changes of the input: what they leave as it was, and that their texts are read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from differences import differences
from hypothesis import given, settings, strategies as st

from replan.contract.planner_rules import context_of, frame_of
from replan.core.errors import ConfigError
from replan.explain.changed_frames import changed, changed_context, limits_that_fit
from replan.explain.input_changes import CHANGES, InputChange, parse
from replan.logs.agents import NUMBERS, AgentKind
from replan.logs.frame import Frame
from replan.logs.past import Earlier
from replan.logs.rules import Colour
from replan.run.log_source import LogSource

SCENARIO = LogSource("everyday/pull_outs").read()
FRAMES = [
    replace(frame_of(SCENARIO, 0.1 * n), lights={1: Colour.RED, 2: Colour.YELLOW})
    for n in range(12)
]
LAST = len(FRAMES) - 1
MIDDLE = LAST // 2
KINDS = frozenset(FRAMES[0].agents.kinds)


@st.composite
def input_changes(draw: st.DrawFn) -> InputChange:
    """A row of the table with one of its values, about all road users or some kinds."""
    name = draw(st.sampled_from(list(CHANGES)))
    row = CHANGES[name]
    kinds = draw(st.frozensets(st.sampled_from(AgentKind))) if row.of_kinds else frozenset()
    return InputChange(name, draw(st.sampled_from(row.tries)), kinds)


PAGE = Path(__file__).parents[3] / "docs" / "experiments.md"


def contents(frame: Frame) -> list[object]:
    """What a frame holds, as values that compare."""
    agents = [getattr(frame.agents, name).tobytes() for name in NUMBERS]
    columns = ("t", "agent", "probability", "x", "y", "yaw")
    predictions = [getattr(frame.predictions, name).tobytes() for name in columns]
    return [frame.t, frame.ego, frame.agents.ids, *agents, *predictions, dict(frame.lights)]


@given(input_changes())
def test_a_change_is_read_back_from_its_text(change: InputChange) -> None:
    assert parse(str(change)) == change


@given(input_changes())
@settings(max_examples=60, deadline=None)
def test_a_changed_frame_is_consistent_and_the_given_one_is_left_as_it_was(
    change: InputChange,
) -> None:
    before = contents(FRAMES[LAST])
    frame = changed(FRAMES, [change])[LAST]
    predictions = frame.predictions
    assert contents(FRAMES[LAST]) == before and frame.t == FRAMES[LAST].t
    assert predictions.x.shape == (len(predictions.agent), len(predictions.t))
    assert ((predictions.agent >= 0) & (predictions.agent < len(frame.agents))).all()
    assert set(frame.agents.ids) <= {name for old in FRAMES for name in old.agents.ids}


@given(input_changes().filter(lambda change: change.row.of_kinds))
@settings(max_examples=60, deadline=None)
def test_a_change_of_kinds_that_are_not_there_changes_nothing(change: InputChange) -> None:
    absent = frozenset(AgentKind) - KINDS
    frame = changed(FRAMES, [replace(change, kinds=absent)])[MIDDLE]
    assert contents(frame) == contents(FRAMES[MIDDLE])


@pytest.mark.parametrize("name", ["shift agents left", "shift agents ahead", "shift agents x"])
def test_two_opposite_shifts_cancel(name: str) -> None:
    changes = [InputChange(name, 1.5), InputChange(name, -1.5)]
    frame = changed(FRAMES, changes)[MIDDLE]
    for column in ("x", "y"):
        moved, given_column = getattr(frame.agents, column), getattr(FRAMES[MIDDLE].agents, column)
        assert np.abs(moved - given_column).max() < 1e-9


def test_delayed_agents_are_those_of_the_earlier_frame_and_of_the_first_one_at_the_start() -> None:
    delayed = changed(FRAMES, [parse("delay agents 4")])
    assert delayed[LAST].agents is FRAMES[LAST - 4].agents
    assert delayed[LAST].ego is FRAMES[LAST].ego
    assert delayed[2].agents is FRAMES[0].agents


@pytest.mark.parametrize("text", ["delay agents 4", "shift agents left 1.5", "lights green"])
def test_the_past_of_a_changed_frame_is_that_of_the_changed_frames(text: str) -> None:
    frames = [
        replace(frame, earlier=Earlier(tuple(before.snapshot for before in FRAMES[:n])))
        for n, frame in enumerate(FRAMES)
    ]
    after = changed(frames, [parse(text)])
    shown = Earlier(tuple(after[n].snapshot for n in range(LAST))).past(after[LAST].snapshot)
    assert not differences(after[LAST].past, shown)
    alone = changed(frames[LAST:], [parse(text)])[0]  # without the frames before: as given
    assert len(alone.past.t) == len(shown.t)
    assert differences(alone.past, shown)


def test_delays_add_up() -> None:
    twice = changed(FRAMES, [parse("delay agents 2"), parse("delay agents 3")])
    assert twice[LAST].agents is FRAMES[LAST - 5].agents


def test_the_limits_that_fit_change_the_frames_as_the_limit_does() -> None:
    change = parse("drop agents beyond 25")
    low, high = limits_that_fit([FRAMES], change)
    assert low <= 25.0 <= high
    for limit in (low + 1e-9, min(high, 1e3) - 1e-9):
        other = changed(FRAMES, [replace(change, value=limit)])
        same = changed(FRAMES, [change])
        assert all(other[n].agents.ids == same[n].agents.ids for n in range(len(FRAMES)))


def test_a_change_of_the_context_is_made_when_the_planner_is_built() -> None:
    context = changed_context(context_of(SCENARIO), [parse("scale speed limits 0.5")])
    limits = {name: lane.speed_limit for name, lane in SCENARIO.road.lanes.items()}
    assert {name: 2.0 * lane.speed_limit for name, lane in context.road.lanes.items()} == (
        pytest.approx(limits, nan_ok=True)
    )
    assert changed(FRAMES, [parse("scale speed limits 0.5")])[MIDDLE] is FRAMES[MIDDLE]


@pytest.mark.parametrize(
    "text",
    [
        "delai agents 3",
        "delay agents",
        "delay agents soon",
        "lights green 3",
        "shift agents left 1 of cows",
        "delay agents 3 of car",
        "",
    ],
)
def test_a_text_that_is_no_change_is_an_error_in_one_line(text: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse(text)
    assert "\n" not in str(error.value)


def test_the_page_lists_every_change() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert [name for name in CHANGES if f"| `{name}" not in page] == []
