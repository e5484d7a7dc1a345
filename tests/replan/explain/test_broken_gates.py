"""The plans before a failed gate, and numbers that contradict what was shown."""

from collections.abc import Iterator
from dataclasses import replace

import pytest

from replan.explain.broken_gates import DEMANDS, BrokenGate, Demand
from replan.explain.contradictions import Contradiction, contradictions, describe_contradictions
from replan.explain.course import Ways
from replan.explain.planner_input import PlannerInput, planner_inputs
from replan.logs.catalogue import CATALOGUE
from replan.logs.plan import Artefact, Decision, DecisionKind
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.replay.loop.closed_loop import run_closed_loop

RED = BrokenGate("red_light.count <= 0", "red_light.count", 4.0, "stop line 1", "")


def cut(name: str, until: float) -> Scenario:
    log = CATALOGUE[name].scenario()
    return replace(log, ego=log.ego.between(0.0, until), duration=until)


def answer_to(gate: BrokenGate, trace: Trace, log: Scenario) -> str:
    demand: Demand = next(row for row in DEMANDS if gate.metric.partition(".")[0] in row.metrics)
    return demand.answer(gate, trace, log)


def with_internals(trace: Trace, internals: tuple[Artefact, ...]) -> Trace:
    frames = tuple(
        replace(frame, plan=replace(frame.plan, internals=internals)) for frame in trace.frames
    )
    return replace(trace, frames=frames)


def found_in(seen: PlannerInput, log: Scenario) -> Iterator[Contradiction]:
    return contradictions(seen, log, Ways(log))


@pytest.fixture(scope="module")
def red_drive() -> tuple[Trace, Scenario]:
    log = cut("everyday/traffic_light", 5.0)
    return run_closed_loop(log, "dp_qp").trace, log


@pytest.fixture(scope="module")
def led_drive() -> tuple[list[PlannerInput], Scenario]:
    log = cut("everyday/follow", 2.0)
    return list(planner_inputs(run_closed_loop(log, "dp_qp").trace, log)), log


def test_the_sentence_of_a_red_light_is_that_of_the_plans(
    red_drive: tuple[Trace, Scenario],
) -> None:
    trace, log = red_drive
    assert "the last decides: stop" in answer_to(RED, trace, log)
    other = Decision("car 7", DecisionKind.FOLLOW, "speed", "")
    blind = answer_to(RED, with_internals(trace, (other,)), log)
    assert blind == "no obstacle at it in any of the 31 plans of the 3 s before"
    ignored = Decision("stop line 1", DecisionKind.IGNORE, "speed", "past the point of no return")
    words = answer_to(RED, with_internals(trace, (ignored,)), log)
    assert "in 31 of the 31 plans" in words
    assert "ignore (past the point of no return)" in words


def test_a_planner_without_artefacts_gives_no_answer(red_drive: tuple[Trace, Scenario]) -> None:
    trace, log = red_drive
    assert "is not known" in answer_to(RED, with_internals(trace, ()), log)


def test_a_metric_has_one_demand() -> None:
    words = [word for demand in DEMANDS for word in demand.metrics]
    assert len(words) == len(set(words))


@pytest.mark.parametrize("shift", (-12.0, 25.0, 40.0))
def test_an_agent_that_was_shown_elsewhere_contradicts_the_graph(
    led_drive: tuple[list[PlannerInput], Scenario], shift: float
) -> None:
    inputs, log = led_drive
    assert not any(list(found_in(seen, log)) for seen in inputs)
    seen = inputs[10]
    shown = replace(seen, agents=replace(seen.agents, x=seen.agents.x + shift))
    (contradiction,) = found_in(shown, log)
    apart_m = contradiction.shown_m - contradiction.drawn_m
    if contradiction.is_straight:
        assert apart_m > 0.0
    else:
        assert apart_m == pytest.approx(shift, abs=1.0)
    (line,) = describe_contradictions([contradiction])
    assert f"{contradiction.shown_m:.2f} m" in line and f"{contradiction.drawn_m:.2f} m" in line
    assert not describe_contradictions([contradiction], least=2)
