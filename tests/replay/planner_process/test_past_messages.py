"""The past of a planner in its own process is that of one in the process of the loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from replan.core.errors import PlannerError
from replan.logs.catalogue import CATALOGUE
from replan.logs.edit.cut import cut
from replan.logs.past import PAST_S, PAST_STEPS
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Mode, Trace
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop_config import DEFAULT_LOOP, LoopConfig
from replan.replay.perception import Perception
from replan.replay.planner_process.messages import Frame, decode, encode
from replan.replay.planner_process.past_messages import ReceivedPast, SentPast, past_s_of
from replan.replay.world import World, logged_ego

PLANNER = "contract_breakers:ReadsPast"
LOG = CATALOGUE["everyday/cut_in"].scenario()


def driven(scenario: Scenario, planner: str, mode: Mode, loop: LoopConfig, trust: bool) -> Trace:
    """The first 3 s, with the planner in this process or in its own."""
    run = run_closed_loop if mode is Mode.CLOSED else run_open_loop
    loop = replace(loop, apart=replace(loop.apart, trust=trust))
    return run(scenario, planner, config=loop, until_s=3.0).trace


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("period_s", [0.1, 0.25])
@pytest.mark.parametrize("planner", [PLANNER, f"{PLANNER}OfMap"])
def test_plans_from_the_past_are_equal_in_both_processes(
    planner: str, period_s: float, mode: Mode
) -> None:
    """The planner bends its path by all bits of the past."""
    part, loop = cut(LOG, 4.0), replace(DEFAULT_LOOP, plan_period_s=period_s)
    plans = [
        [
            frame.plan.trajectory.kappa[0]
            for frame in driven(part, planner, mode, loop, trust).frames
        ]
        for trust in (True, False)
    ]
    assert plans[0] == plans[1]
    assert len(set(plans[0])) == len(plans[0])


def test_a_planner_that_did_not_ask_is_told_how() -> None:
    trace = driven(LOG, f"{PLANNER}Unasked", Mode.OPEN, DEFAULT_LOOP, trust=False)
    assert trace.end is EndReason.PLANNER_FAILURE
    assert "past_s = 2.1" in trace.detail


def test_each_moment_is_sent_once_and_none_to_who_does_not_ask() -> None:
    part = cut(LOG, 4.0)
    perception = Perception(part, DEFAULT_LOOP)
    sent, plain, received = SentPast(PAST_S), SentPast(0.0), ReceivedPast(PAST_S)
    for k in range(30):
        ego = logged_ego(part.ego, part.vehicle, round(0.1 * k, 6))
        frame = perception.frame(World(ego, part.tracks), None)
        message = sent.message(frame)
        assert len(message.earlier) == (PAST_STEPS if k == 0 else 0)
        assert b"earlier" not in encode(plain.message(frame))
        again = received.frame(decode(encode(message), Frame))
        np.testing.assert_array_equal(again.past.x, frame.past.x)
        assert again.past.source == frame.past.source


@pytest.mark.parametrize("asked", [-1.0, 2.2, "all"])
def test_a_past_that_cannot_be_had_is_refused(asked: object) -> None:
    class Asks:
        past_s = asked

    with pytest.raises(PlannerError, match="past_s"):
        past_s_of(Asks)
